typedef void (*callback)(const void *model, void *data);
typedef void (*listener)(const char *text);
static const double *now_q, *now_v, *now_thrust, *now_p, *now_e;
static double *now_force;

static void water(const void *model, void *data)
{
    double force[DOF];
    (void)model;
    (void)data;
    surctl_fluid(now_q, now_v, now_thrust, now_p, now_e, force);
    for (int k = 0; k < DOF; ++k) {
        now_force[k] += force[k];
    }
}

static void quiet(const char *text)
{
    (void)text;
}

void surctl_advance(callback step, callback *slot, listener *warned, const void *model, void *data, long count,
                    const double *q, const double *v, const double *thrust, const double *p, const double *e,
                    double *force);
void surctl_advance(callback step, callback *slot, listener *warned, const void *model, void *data, long count,
                    const double *q, const double *v, const double *thrust, const double *p, const double *e,
                    double *force)
{
    const callback before = *slot;
    const listener usual = *warned;
    now_q = q;
    now_v = v;
    now_thrust = thrust;
    now_p = p;
    now_e = e;
    now_force = force;
    *slot = water;
    *warned = quiet;  /* MuJoCo would write to MUJOCO_LOG.TXT; the number of warnings is in the data */
    for (long k = 0; k < count; ++k) {
        step(model, data);
    }
    *slot = before;
    *warned = usual;
}
