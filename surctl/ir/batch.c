long surctl_lanes(void);
long surctl_lanes(void) { return LANES; }

long surctl_state(void);
long surctl_state(void) { return STATE; }

long surctl_parameters(void);
long surctl_parameters(void) { return PARAMETERS; }

/* size of the memory that one thread needs, in numbers */
long surctl_work(void);
long surctl_work(void) { return (long)LANES * (STATE + PARAMETERS + WORK); }

/* load the next unfinished run into this lane; a run that needs no step is copied to the output */
static void refill(const double *state, const double *parameters, double *out, double *memory, long *book, int lane,
    long steps)
{
    long *const run = book + 4 + lane;
    *run = -1;
    while (*run < 0 && book[0] < book[1]) {
        const long next = book[0]++;
        const double *const from = state + next * STATE;
        if (from[0] != 0.0 || steps == 0) {
            for (int k = 0; k < STATE; ++k) { out[next * STATE + k] = from[k]; }
            continue;
        }
        for (int k = 0; k < STATE; ++k) { memory[k * LANES + lane] = from[k]; }
        double *const own = memory + STATE * LANES;
        for (int k = 0; k < PARAMETERS; ++k) { own[k * LANES + lane] = parameters[next * PARAMETERS + k]; }
        *run = next;
        run[LANES] = steps;
    }
}

/* a lane without a run repeats the computation of an active lane */
static void shadow(double *memory, const long *book)
{
    int busy = 0;
    while (busy < LANES && book[4 + busy] < 0) { ++busy; }
    for (int lane = 0; lane < LANES && busy < LANES; ++lane) {
        if (book[4 + lane] >= 0) { continue; }
        for (int k = 0; k < STATE + PARAMETERS; ++k) { memory[k * LANES + lane] = memory[k * LANES + busy]; }
    }
}

/* at most `chunk` steps, fewer if a lane is free and no run is left; returns the number of steps */
long surctl_go(const double *state, const double *parameters, double *out, double *memory, long *book, long steps,
    long chunk);
long surctl_go(const double *state, const double *parameters, double *out, double *memory, long *book, long steps,
    long chunk)
{
    double *const own = memory + STATE * LANES;
    double *const work = own + PARAMETERS * LANES;
    long done = 0;
    for (;;) {
        long left = chunk - done, busy = 0, idle = 0;
        for (int lane = 0; lane < LANES; ++lane) {
            if (book[4 + lane] < 0) {
                refill(state, parameters, out, memory, book, lane, steps);
                ++idle;
            }
            if (book[4 + lane] >= 0) {
                ++busy;
                left = (book[4 + LANES + lane] < left) ? book[4 + LANES + lane] : left;
            }
        }
        book[3] = busy;
        if (busy == 0 || done == chunk || (busy < LANES && book[2] != 0)) { return done; }
        if (idle > 0 && busy < LANES) { shadow(memory, book); }
        long count = 0;
        do {
            surctl_step(memory, own, memory, work);
            ++count;
        } while (count < left && running(memory) == ALL_LANES);
        done += count;
        for (int lane = 0; lane < LANES; ++lane) {
            const long run = book[4 + lane];
            if (run < 0) { continue; }
            book[4 + LANES + lane] -= count;
            if (memory[lane] == 0.0 && book[4 + LANES + lane] > 0) { continue; }
            for (int k = 0; k < STATE; ++k) { out[run * STATE + k] = memory[k * LANES + lane]; }
            book[4 + lane] = -1;
        }
    }
}
