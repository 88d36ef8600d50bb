/* The closed loop of one scenario, written by hand: plant, world, sonar, filters, guidance, priority, velocity loop
 * and metrics, one run at a time. Scalar code with early exits: what is not there costs nothing. Library sines.
 * Law `guarded`; priority mode `nsb` or `projected`; true positions or sonar. Units as in the toolkit: SI, {E} z up. */
#include <math.h>
#include <stdint.h>
#include <string.h>

enum { POINTS = 8, OBSTACLES = 16, CONTACTS = 8, SECTORS = CONTACTS + 4 + 4, ROWS = 4 + SECTORS, SENSORS = 4 };
enum { BOX, DISC, MOVING };
enum { TIME_LIMIT, REACHED, COLLISION, FAULT };

typedef struct { double shape, x, y, hx, hy, drift, rate, tx, ty, speed, removed; } Obstacle; /* hx: radius of a disc */
typedef struct { double mass[4], linear[4], quadratic[4], limit[4]; } Body;
typedef struct {
    double dt, sonar, projected, ticks, start[2], target[2], depth, cruise, cap, reach, length, width;
    double points, way[POINTS][2];
    Body plant;
    double lag, hull;
    Body model;
    double model_hull, current[2], wave_force, wave_period, count;
    Obstacle obstacle[OBSTACLES];
} Scene;
typedef struct {
    double k1, k2, lookahead, wait, k_psi, k_v, k_r, k_i, margin, reaction, brake, kappa, k3, delta;
    double lambda1, lms_step, beta_max;
} Gains;
typedef struct { double wave[2], wave_phase, drift[OBSTACLES][3]; } Luck; /* drift: direction, phase */
typedef struct {
    double reached, collided, time, clearance, path_error, deviation, max_deviation, overshoot, length, effort;
    double peak, saturated, thrust_rate, stopped;
} Metrics;

static double clip(double v, double low, double high) { return v < low ? low : v > high ? high : v; }
static double least(double a, double b) { return a < b ? a : b; }
static double most(double a, double b) { return a > b ? a : b; }
static double length2(double x, double y) { return sqrt(x * x + y * y); }

/* ---- MRG32k3a (L'Ecuyer 1999), stream s: the base state s times 2^127 further */
#define M1 4294967087ULL
#define M2 4294944443ULL
typedef struct { int64_t a[3], b[3]; } Random;
typedef uint64_t Matrix[3][3];
typedef struct { Matrix a, b; } Jump;

static void times(Matrix out, Matrix a, Matrix b, uint64_t m)
{
    Matrix c;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            uint64_t sum = 0;
            for (int k = 0; k < 3; k++) sum = (sum + a[i][k] * b[k][j] % m) % m;
            c[i][j] = sum;
        }
    memcpy(out, c, sizeof c);
}

static Jump long_jump(void)
{
    Jump j = {{{0, 1, 0}, {0, 0, 1}, {M1 - 810728, 1403580, 0}}, {{0, 1, 0}, {0, 0, 1}, {M2 - 1370589, 0, 527612}}};
    for (int i = 0; i < 127; i++) times(j.a, j.a, j.a, M1), times(j.b, j.b, j.b, M2);
    return j;
}

static void jumped(int64_t state[3], Matrix step, uint64_t m, uint64_t seed)
{
    Matrix power, all = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    memcpy(power, step, sizeof power);
    for (; seed; seed >>= 1, times(power, power, power, m))
        if (seed & 1) times(all, all, power, m);
    for (int i = 0; i < 3; i++) state[i] = (int64_t)((all[i][0] + all[i][1] + all[i][2]) % m * 12345 % m);
}

static Random random_stream(Jump *step, uint64_t seed)
{
    Random r;
    jumped(r.a, step->a, M1, seed);
    jumped(r.b, step->b, M2, seed);
    return r;
}

static double uniform(Random *r)
{
    int64_t p = (1403580 * r->a[1] - 810728 * r->a[0]) % (int64_t)M1;
    int64_t q = (527612 * r->b[2] - 1370589 * r->b[0]) % (int64_t)M2;
    if (p < 0) p += M1;
    if (q < 0) q += M2;
    r->a[0] = r->a[1], r->a[1] = r->a[2], r->a[2] = p;
    r->b[0] = r->b[1], r->b[1] = r->b[2], r->b[2] = q;
    return (double)(p > q ? p - q : p + (int64_t)M1 - q) * 2.328306549295728e-10;
}

static void normals(Random *r, double *out, int count)
{
    for (int i = 0; i < count; i += 2) {
        double radius = sqrt(-2 * log(uniform(r))), angle = 6.283185307179586 * uniform(r);
        out[i] = radius * cos(angle), out[i + 1] = radius * sin(angle);
    }
}

/* ---- the world */
typedef struct { int shape, there; double x, y, hx, hy, vx, vy; } Shape;

static void place(const Scene *s, const Luck *luck, double time, Shape *shape)
{
    for (int k = 0; k < (int)s->count; k++, shape++) {
        const Obstacle *o = &s->obstacle[k];
        shape->shape = o->shape == BOX ? BOX : DISC, shape->there = 1;
        shape->x = o->x, shape->y = o->y, shape->hx = o->hx, shape->hy = o->hy, shape->vx = shape->vy = 0;
        if (o->shape == MOVING) {
            double wx = o->tx - o->x, wy = o->ty - o->y, distance = length2(wx, wy);
            if (o->speed * time >= distance) {
                shape->x = o->tx, shape->y = o->ty, shape->there = !(int)o->removed;
            } else {
                shape->vx = o->speed * wx / distance, shape->vy = o->speed * wy / distance;
                shape->x += shape->vx * time, shape->y += shape->vy * time;
            }
        } else if (o->drift > 0) {
            double angle = o->rate * time + luck->drift[k][2];
            double far = o->drift * sin(angle), speed = o->drift * o->rate * cos(angle);
            shape->x += far * luck->drift[k][0], shape->y += far * luck->drift[k][1];
            shape->vx = speed * luck->drift[k][0], shape->vy = speed * luck->drift[k][1];
        }
    }
}

/* signed distance and the nearest point of the surface */
static double foot(const Shape *o, double x, double y, double *fx, double *fy)
{
    double dx = x - o->x, dy = y - o->y;
    if (o->shape == DISC) {
        double far = length2(dx, dy), ux = far > 0 ? dx / far : 1, uy = far > 0 ? dy / far : 0;
        *fx = o->x + o->hx * ux, *fy = o->y + o->hx * uy;
        return far - o->hx;
    }
    double qx = clip(dx, -o->hx, o->hx), qy = clip(dy, -o->hy, o->hy), far = length2(dx - qx, dy - qy);
    if (far == 0) {
        double ox = fabs(dx) - o->hx, oy = fabs(dy) - o->hy;
        far = most(ox, oy);
        if (ox >= oy) qx = dx >= 0 ? o->hx : -o->hx;
        else qy = dy >= 0 ? o->hy : -o->hy;
    }
    *fx = o->x + qx, *fy = o->y + qy;
    return far;
}

static void slab(double p, double d, double half, double *near, double *far)
{
    if (d == 0) {
        *near = fabs(p) <= half ? -INFINITY : INFINITY, *far = -*near;
        return;
    }
    double a = (-half - p) / d, b = (half - p) / d;
    *near = least(a, b), *far = most(a, b);
}

static double ray(const Shape *o, double x, double y, double ex, double ey)
{
    double dx = o->x - x, dy = o->y - y;
    if (o->shape == DISC) {
        double along = dx * ex + dy * ey, across = dx * ey - dy * ex, square = o->hx * o->hx - across * across;
        return along > 0 && square >= 0 ? along - sqrt(square) : INFINITY;
    }
    double nx, ny, fx, fy;
    slab(-dx, ex, o->hx, &nx, &fx);
    slab(-dy, ey, o->hy, &ny, &fy);
    double near = most(nx, ny);
    return near >= 0 && near <= least(fx, fy) ? near : INFINITY;
}

/* ---- sonar: 75 degrees, 0.2 to 4.5 m, 8 bits */
#define COS_HALF 0.7933533402912352
#define SIN_HALF 0.6087614290087205
#define FARTHEST 4.5
#define NEAREST 0.2

static void turned(int sensor, double c, double s, double axis[2])
{
    axis[0] = sensor == 0 ? c : sensor == 1 ? -s : sensor == 2 ? -c : s;
    axis[1] = sensor == 0 ? s : sensor == 1 ? c : sensor == 2 ? -s : -c;
}

static void fire(const Scene *s, const Shape *shapes, int sensor, const double *eta, const double *noise, double *samples)
{
    double axis[2], found = INFINITY, c = cos(eta[3]), sn = sin(eta[3]);
    turned(sensor, c, sn, axis);
    double x = eta[0] + s->hull * axis[0], y = eta[1] + s->hull * axis[1];
    double lx = axis[0] * COS_HALF - axis[1] * SIN_HALF, ly = axis[1] * COS_HALF + axis[0] * SIN_HALF;
    double rx = axis[0] * COS_HALF + axis[1] * SIN_HALF, ry = axis[1] * COS_HALF - axis[0] * SIN_HALF;
    for (int k = 0; k < (int)s->count; k++) {
        double fx, fy, far;
        if (!shapes[k].there || (far = foot(&shapes[k], x, y, &fx, &fy)) >= found) continue;
        if (far <= 0) far = 0;
        else if ((fx - x) * axis[0] + (fy - y) * axis[1] < far * (COS_HALF - 1e-12))
            far = least(ray(&shapes[k], x, y, lx, ly), ray(&shapes[k], x, y, rx, ry));
        found = least(found, far);
    }
    double distance[4] = {x, s->length - x, y, s->width - y};
    double nx[4] = {-1, 1, 0, 0}, ny[4] = {0, 0, -1, 1};
    for (int k = 0; k < 4; k++) {
        double far = distance[k];
        if (far >= found) continue;
        if (far <= 0) far = 0;
        else if (nx[k] * axis[0] + ny[k] * axis[1] < COS_HALF - 1e-12) {
            double left = lx * nx[k] + ly * ny[k], right = rx * nx[k] + ry * ny[k], best = most(left, right);
            far = best > 0 ? far / best : INFINITY;
        }
        found = least(found, far);
    }
    for (int k = 0; k < 5; k++)
        samples[k] = found > FARTHEST ? FARTHEST
            : rint(clip(found + 0.0011 + 0.015 * noise[k], NEAREST, FARTHEST) * 255 / FARTHEST) * FARTHEST / 255;
}

/* ---- filter of one sensor: average, gate, LMS with momentum */
typedef struct {
    double window[8], history[4], theta[4], before[4], errors[8], mean_error, echo[2], age;
    int refused;
} Filter;

static void push(double *window, int n, double value)
{
    memmove(window + 1, window, (size_t)(n - 1) * sizeof *window);
    window[0] = value;
}

static double range_of(Filter *f, const double *sample, const Gains *g)
{
    double value = (sample[0] + 2 * sample[1] + 3 * sample[2] + 4 * sample[3] + 5 * sample[4]) / 15;
    double mean = 0, square = 0, predicted = 0, power = 0, corrected = 0;
    for (int i = 0; i < 8; i++) mean += f->window[i] / 8, square += f->window[i] * f->window[i] / 8;
    double spread = most(sqrt(most(square - mean * mean, 0)), FARTHEST / 255);
    int accepted = fabs(value - f->window[0]) < g->lambda1 * spread;
    double gated = accepted ? value : mean;
    push(f->window, 8, value);
    f->refused = accepted || !(g->lambda1 > 0) ? 0 : f->refused < 3 ? f->refused + 1 : 3;
    if (accepted && fabs(gated - f->history[0]) > 0.3) {
        for (int i = 0; i < 4; i++) f->history[i] = gated, f->theta[i] = f->before[i] = 0.25;
    } else {
        for (int i = 0; i < 4; i++) predicted += f->theta[i] * f->history[i], power += f->history[i] * f->history[i];
        double residual = gated - predicted;
        push(f->errors, 8, fabs(residual));
        for (int i = 0; i < 8; i++) corrected += (8 - i) / 64.0 * f->errors[i];
        if (corrected >= f->mean_error) {
            double step = clip(g->lms_step, 0, 1) * residual / most(power, 1e-6);
            double beta = clip(g->beta_max, 0, 0.5) * least(1, corrected / most(f->mean_error, 1e-9));
            for (int i = 0; i < 4; i++) {
                double old = f->theta[i];
                f->theta[i] += step * f->history[i] + beta * (old - f->before[i]);
                f->before[i] = old;
            }
        } else {
            memcpy(f->before, f->theta, sizeof f->theta);
        }
        f->mean_error += (corrected - f->mean_error) / 8;
        push(f->history, 4, gated);
    }
    predicted = 0;
    for (int i = 0; i < 4; i++) predicted += f->theta[i] * f->history[i];
    return clip(least(f->history[0], predicted), NEAREST, FARTHEST);
}

/* ---- echoes of known walls and obstacles */
static double expected(const Scene *s, const double axis[2], double x, double y, double (*known)[5], int count)
{
    double found = 2 * FARTHEST, distance[4] = {s->length - x, x, s->width - y, y};
    double nx[4] = {1, -1, 0, 0}, ny[4] = {0, 0, 1, -1};
    for (int k = 0; k < 4; k++) {
        double along = axis[0] * nx[k] + axis[1] * ny[k], across = fabs(axis[0] * ny[k] - axis[1] * nx[k]);
        double edge = along * COS_HALF + across * SIN_HALF;
        double seen = along >= COS_HALF ? distance[k] : edge > 1e-9 ? distance[k] / edge : 2 * FARTHEST;
        found = least(found, most(seen, 0));
    }
    for (int k = 0; k < count; k++) {
        double tx = known[k][0] - x, ty = known[k][1] - y, radius = known[k][2], far = length2(tx, ty);
        if (far <= radius) return 0;
        if (far - radius >= found) continue;
        double seen = far - radius;
        if (tx * axis[0] + ty * axis[1] < far * COS_HALF) {
            seen = 2 * FARTHEST;
            for (int side = -1; side <= 1; side += 2) {
                double rx = axis[0] * COS_HALF - side * axis[1] * SIN_HALF, ry = axis[1] * COS_HALF + side * axis[0] * SIN_HALF;
                double along = tx * rx + ty * ry, across = tx * ry - ty * rx, square = radius * radius - across * across;
                if (along > 0 && square >= 0) seen = least(seen, along - sqrt(square));
            }
        }
        found = least(found, seen);
    }
    return found;
}

/* ---- choice of a course */
typedef struct { double nx, ny, bound, px, py; } Sector;

static double excess(double vx, double vy, const Sector *sector, int count)
{
    double worst = -10;
    for (int k = 0; k < count; k++) worst = most(worst, vx * sector[k].nx + vy * sector[k].ny - sector[k].bound);
    return worst;
}

/* the largest violation of a bound (0 if none), and the normal of this bound */
static double worst_bound(double vx, double vy, const Sector *sector, int count, double normal[2])
{
    double over = 0;
    normal[0] = normal[1] = 0;
    for (int k = 0; k < count; k++) {
        double excess = vx * sector[k].nx + vy * sector[k].ny - sector[k].bound;
        if (excess > over) over = excess, normal[0] = sector[k].nx, normal[1] = sector[k].ny;
    }
    return over;
}

/* brake harder than the velocity loop alone, without sideways force, if the robot exceeds a speed bound */
static void brake_beyond(double vx, double vy, const Sector *sector, int count, double velocity[2])
{
    double n[2], other[2], over = worst_bound(vx, vy, sector, count, n);
    double along = (velocity[0] - vx) * n[0] + (velocity[1] - vy) * n[1];
    double sx = vx + along * n[0], sy = vy + along * n[1], beyond = worst_bound(sx, sy, sector, count, other);
    double share = least(over / 0.02, 1);
    velocity[0] += share * (sx - beyond * other[0] - velocity[0]) - 4 * over * n[0];
    velocity[1] += share * (sy - beyond * other[1] - velocity[1]) - 4 * over * n[1];
}

typedef struct { double side, blocker[2]; } Latch;

static int choose(const Scene *s, const double wish[2], const Sector *sector, int count, Latch *latch, double out[2])
{
    double wished = most(length2(wish[0], wish[1]), 1e-3), ax = wish[0] / wished, ay = wish[1] / wished, retreat = 0;
    for (int k = 0; k < count; k++) retreat = most(retreat, least(-sector[k].bound, s->cap));
    double speed = excess(wished * ax, wished * ay, sector, count) > 1e-3 ? least(wished, s->cruise) : wished;
    if (retreat > 0) speed = most(speed, least(retreat + 0.05, s->cap));

    double worst = -10, bx = sector[0].px, by = sector[0].py;
    for (int k = 0; k < count; k++) {
        double missed = speed * (ax * sector[k].nx + ay * sector[k].ny) - sector[k].bound;
        if (missed > worst) worst = missed, bx = sector[k].px, by = sector[k].py;
    }
    double gx = bx - latch->blocker[0], gy = by - latch->blocker[1];
    double latched = gx * gx + gy * gy <= 0.09 ? latch->side : 0, taken = 0, missed = worst, cx = ax, cy = ay;
    int blocked = missed > 1e-3;
    if (blocked) {
        double cheapest = 10 + 100 * missed;
        for (int sign = 1; sign >= -1; sign -= 2)
            for (int k = 0; k < count; k++) {
                if (sector[k].bound >= speed) continue;
                double c = clip(sector[k].bound / speed, -1, 1), sn = sign * sqrt(1 - c * c);
                double ex = sector[k].nx * c - sector[k].ny * sn, ey = sector[k].ny * c + sector[k].nx * sn;
                double left = ax * ey - ay * ex >= 0 ? 1 : -1;
                double cost = 1 - ex * ax - ey * ay + (sign > 0 ? 0 : 1e-4) + (latched * left < -0.5 ? 8 : 0);
                if (cost >= cheapest) continue;
                double over = excess(speed * ex, speed * ey, sector, count);
                if (over > 1e-3) cost += 10 + 100 * over;
                if (cost < cheapest) cheapest = cost, cx = ex, cy = ey, missed = over, taken = left;
            }
    }
    double fast = speed;
    for (int k = 0; k < count; k++) {
        double along = cx * sector[k].nx + cy * sector[k].ny;
        if (along > 1e-3) fast = least(fast, most(sector[k].bound, 0) / along);
    }
    fast = most(fast, retreat);
    out[0] = fast * cx, out[1] = fast * cy;
    if (missed > 1e-3 && excess(out[0], out[1], sector, count) > excess(0, 0, sector, count) + 1e-3) out[0] = out[1] = 0;
    latch->side = blocked ? taken : 0, latch->blocker[0] = bx, latch->blocker[1] = by;
    return blocked;
}

/* ---- least distance: the dual method of Goldfarb and Idnani for min |x - base|, a x <= b, in d <= 3 dimensions */
typedef struct { double a[3], b; } Row;

static int nearest(int d, const double *base, const Row *row, int rows, double *x)
{
    int active[3], n = 0;
    double u[4] = {0};
    memcpy(x, base, (size_t)d * sizeof *x);
    for (int turn = 0; turn < 100; turn++) {
        int p = -1;
        double worst = 1e-12;
        for (int k = 0; k < rows; k++) {
            double miss = -row[k].b;
            for (int i = 0; i < d; i++) miss += row[k].a[i] * x[i];
            if (miss > worst) worst = miss, p = k;
        }
        if (p < 0) return 1;
        u[n] = 0;
        for (int step = 0; step < 100; step++) {
            /* Gram-Schmidt of the active normals; z: component of the new normal outside their span; r: its coefficients */
            double q[3][3], t[3][3], r[3], z[3], zz = 0, miss = -row[p].b, limit = INFINITY;
            for (int j = 0; j < n; j++) {
                memcpy(q[j], row[active[j]].a, sizeof q[j]);
                for (int k = 0; k < j; k++) {
                    t[k][j] = 0;
                    for (int i = 0; i < d; i++) t[k][j] += q[k][i] * q[j][i];
                    for (int i = 0; i < d; i++) q[j][i] -= t[k][j] * q[k][i];
                }
                t[j][j] = 0;
                for (int i = 0; i < d; i++) t[j][j] += q[j][i] * q[j][i];
                t[j][j] = sqrt(t[j][j]);
                for (int i = 0; i < d; i++) q[j][i] /= t[j][j];
            }
            memcpy(z, row[p].a, sizeof z);
            for (int j = 0; j < n; j++) {
                r[j] = 0;
                for (int i = 0; i < d; i++) r[j] += q[j][i] * z[i];
                for (int i = 0; i < d; i++) z[i] -= r[j] * q[j][i];
            }
            for (int j = n - 1; j >= 0; j--) {
                for (int k = j + 1; k < n; k++) r[j] -= t[j][k] * r[k];
                r[j] /= t[j][j];
            }
            int drop = -1;
            for (int j = 0; j < n; j++)
                if (r[j] > 1e-12 && u[j] / r[j] < limit) limit = u[j] / r[j], drop = j;
            for (int i = 0; i < d; i++) zz += z[i] * row[p].a[i], miss += row[p].a[i] * x[i];
            double full = zz > 1e-14 && n < d ? miss / zz : INFINITY, go = least(full, limit);
            if (go == INFINITY) return 0; /* the rows contradict each other */
            if (full < INFINITY) for (int i = 0; i < d; i++) x[i] -= go * z[i];
            for (int j = 0; j < n; j++) u[j] -= go * r[j];
            u[n] += go;
            if (full <= limit) {
                active[n++] = p;
                break;
            }
            for (int j = drop; j + 1 < n; j++) active[j] = active[j + 1];
            for (int j = drop; j < n; j++) u[j] = u[j + 1];
            n--;
        }
    }
    return 0;
}

/* The last projection of mode `projected`, for this law: the velocity task fixes u and v, depth and heading fix w and
 * r, and no row couples the two pairs. So: met if free; else the nearest (u, v) in the rows; else the least opening. */
static int project(const Scene *s, const double task[2], const Sector *sector, int count, double c, double sn, double v[2])
{
    Row row[ROWS];
    int rows = 4, met = fabs(task[0]) <= s->cap && fabs(task[1]) <= s->cap;
    for (int k = 0; k < 4; k++) row[k] = (Row){{k == 0 ? 1 : k == 1 ? -1 : 0, k == 2 ? 1 : k == 3 ? -1 : 0, 0}, s->cap};
    for (int k = 0; k < count; k++) {
        double a = c * sector[k].nx + sn * sector[k].ny, b = -sn * sector[k].nx + c * sector[k].ny;
        met = met && a * task[0] + b * task[1] <= sector[k].bound + 1e-12;
        row[rows++] = (Row){{a, b, 0}, sector[k].bound};
    }
    memcpy(v, task, 2 * sizeof *v);
    if (met) return 1;
    if (nearest(2, task, row, rows, v)) return 1;
    /* least relaxation t: proximal steps of min t, each a least-distance problem in (u, v, t) */
    double low[3] = {clip(task[0], -s->cap, s->cap), clip(task[1], -s->cap, s->cap), 0}, pull = 1;
    for (int k = 4; k < rows; k++) row[k].a[2] = -1;
    for (int turn = 0; turn < 20; turn++, pull *= 10) {
        double base[3] = {low[0], low[1], low[2] - pull}, next[3], moved = 0;
        if (!nearest(3, base, row, rows, next)) break;
        for (int i = 0; i < 3; i++) moved = most(moved, fabs(next[i] - low[i])), low[i] = next[i];
        if (moved <= 1e-12) break;
    }
    for (int k = 4; k < rows; k++) row[k].a[2] = 0, row[k].b += low[2] + 1e-10;
    if (!nearest(2, task, row, rows, v)) v[0] = low[0], v[1] = low[1];
    return 0;
}

/* ---- plant: eta, nu, thrust; Runge-Kutta of order 4 */
static void rate(const Scene *s, const double *x, const double *wanted, const double *force, double *dx)
{
    const Body *b = &s->plant;
    double c = cos(x[3]), sn = sin(x[3]), thrust[4], relative[4];
    double cx = c * s->current[0] + sn * s->current[1], cy = -sn * s->current[0] + c * s->current[1];
    double fx = c * force[0] + sn * force[1], fy = -sn * force[0] + c * force[1];
    const double *nu = x + 4;
    for (int i = 0; i < 4; i++) {
        thrust[i] = s->lag > 0 ? x[8 + i] : wanted[i];
        dx[8 + i] = s->lag > 0 ? (wanted[i] - x[8 + i]) / most(s->lag, 1e-3) : 0;
    }
    relative[0] = nu[0] - cx, relative[1] = nu[1] - cy, relative[2] = nu[2], relative[3] = nu[3];
    for (int i = 0; i < 4; i++)
        thrust[i] -= (b->linear[i] + b->quadratic[i] * fabs(relative[i])) * relative[i];
    thrust[0] += fx + b->mass[1] * relative[1] * relative[3];
    thrust[1] += fy - b->mass[0] * relative[0] * relative[3];
    thrust[3] -= (b->mass[1] - b->mass[0]) * relative[0] * relative[1];
    dx[0] = c * nu[0] - sn * nu[1], dx[1] = sn * nu[0] + c * nu[1], dx[2] = nu[2], dx[3] = nu[3];
    for (int i = 0; i < 4; i++) dx[4 + i] = thrust[i] / b->mass[i];
    dx[4] += nu[3] * cy, dx[5] -= nu[3] * cx;
}

static void advance(const Scene *s, double *x, const double *tau, const double *force)
{
    static const double steps[3] = {0.010, 0.010, 0.005};
    double wanted[4], k1[12], k2[12], k3[12], k4[12], at[12];
    for (int i = 0; i < 4; i++) wanted[i] = clip(tau[i], -s->plant.limit[i], s->plant.limit[i]);
    for (int n = 0; n < 3; n++) {
        double h = steps[n];
        rate(s, x, wanted, force, k1);
        for (int i = 0; i < 12; i++) at[i] = x[i] + h / 2 * k1[i];
        rate(s, at, wanted, force, k2);
        for (int i = 0; i < 12; i++) at[i] = x[i] + h / 2 * k2[i];
        rate(s, at, wanted, force, k3);
        for (int i = 0; i < 12; i++) at[i] = x[i] + h * k3[i];
        rate(s, at, wanted, force, k4);
        for (int i = 0; i < 12; i++) x[i] += h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]);
    }
}

/* ---- one run */
static double away_from_path(const Scene *s, double x, double y)
{
    double best = INFINITY;
    for (int k = 0; k + 1 < (int)s->points; k++) {
        double ax = s->way[k][0], ay = s->way[k][1], wx = s->way[k + 1][0] - ax, wy = s->way[k + 1][1] - ay;
        double t = clip(((x - ax) * wx + (y - ay) * wy) / (wx * wx + wy * wy), 0, 1);
        double ex = x - ax - t * wx, ey = y - ay - t * wy;
        best = least(best, ex * ex + ey * ey);
    }
    return sqrt(best);
}

static double wall_distance(const Scene *s, const double *x)
{
    return least(least(x[0], s->length - x[0]), least(x[1], s->width - x[1]));
}

static void fly(const Scene *s, const Gains *g, const Luck *luck, Jump *step, uint64_t seed, Metrics *out)
{
    int sonar = (int)s->sonar, count = (int)s->count, points = (int)s->points, moving = 0, stopped = TIME_LIMIT;
    double chord[POINTS], tx[POINTS], ty[POINTS], path = 0;
    for (int k = 0; k + 1 < points; k++) {
        double wx = s->way[k + 1][0] - s->way[k][0], wy = s->way[k + 1][1] - s->way[k][1];
        chord[k] = length2(wx, wy), tx[k] = wx / chord[k], ty[k] = wy / chord[k], path += chord[k];
    }
    const Body *m = &s->model;
    double brake = g->brake * least(m->limit[0], m->limit[1]) / most(m->mass[0], m->mass[1]), at = brake * g->reaction;
    double root = sqrt(m->linear[3] * m->linear[3] + 4 * m->quadratic[3] * 0.85 * m->limit[3]);
    double turn = 2 * 0.85 * m->limit[3] / most(m->linear[3] + root, 1e-6);
    for (int k = 0; k < count; k++) moving += s->obstacle[k].shape == MOVING;

    double x[12] = {s->start[0], s->start[1], s->depth, atan2(s->way[1][1] - s->start[1], s->way[1][0] - s->start[0])};
    double progress = 0, integral[4] = {0}, samples[SENSORS][5], noise[14 + 4 * OBSTACLES];
    int fresh[SENSORS] = {0}, clear = 0, settling = 0, kept = 0, saturated = 0, firing = 0, tick;
    Latch latch = {0};
    Filter filter[SENSORS];
    Random random = random_stream(step, sonar ? seed : 0);
    for (int i = 0; i < SENSORS; i++) {
        Filter *f = &filter[i];
        memset(f, 0, sizeof *f);
        for (int k = 0; k < 8; k++) f->window[k] = FARTHEST;
        for (int k = 0; k < 4; k++) f->history[k] = FARTHEST, f->theta[k] = f->before[k] = 0.25;
        f->age = 0.55, f->refused = 3;
    }
    memset(out, 0, sizeof *out);
    double nearest_thing = INFINITY, error = 0, square = 0, last[4] = {0}, px = 0, py = 0, jerk = 0;

    for (tick = 0; tick < (int)s->ticks; tick++) {
        double time = tick * s->dt, clearance = INFINITY, fx[OBSTACLES], fy[OBSTACLES], far[OBSTACLES];
        double known[CONTACTS][5], eta[4];
        Shape shape[OBSTACLES];
        place(s, luck, time, shape);
        if (sonar) {
            normals(&random, noise, 14 + 4 * moving);
            fire(s, shape, firing, x, noise, samples[firing]);
            fresh[firing] = 1, firing = (firing + 1) % SENSORS;
        }
        for (int k = 0; k < count; k++)
            if (shape[k].there) {
                far[k] = foot(&shape[k], x[0], x[1], &fx[k], &fy[k]);
                clearance = least(clearance, far[k] - s->hull);
            }
        double wall = wall_distance(s, x) - s->hull;
        clear |= wall > 0;
        if (clear) clearance = least(clearance, wall);
        nearest_thing = least(nearest_thing, clearance);

        /* inputs of the law */
        int told = 0, order = 0;
        memcpy(eta, x, sizeof eta);
        for (int k = 0; k < count; k++) {
            int is_moving = s->obstacle[k].shape == MOVING;
            order += is_moving;
            if (!shape[k].there || told == CONTACTS || (sonar && !is_moving)) continue;
            double *row = known[told++];
            row[0] = shape[k].shape == DISC ? shape[k].x : fx[k], row[1] = shape[k].shape == DISC ? shape[k].y : fy[k];
            row[2] = shape[k].shape == DISC ? shape[k].hx : 0, row[3] = shape[k].vx, row[4] = shape[k].vy;
            if (sonar) {
                const double *n = noise + 14 + 4 * (order - 1);
                row[0] += 0.01 * n[0], row[1] += 0.01 * n[1], row[3] += 0.01 * n[2], row[4] += 0.01 * n[3];
            }
        }
        if (sonar) for (int i = 0; i < 4; i++) eta[i] += 0.01 * noise[10 + i];
        double c = cos(eta[3]), sn = sin(eta[3]);

        /* desired velocity */
        double travelled = 0, wish[2], tau[4], wanted[4];
        int k = 0;
        while (k + 2 < points && progress >= travelled + chord[k]) travelled += chord[k++];
        double along = clip(progress - travelled, 0, chord[k]);
        double gx = s->way[k][0] + along * tx[k], gy = s->way[k][1] + along * ty[k], ox = eta[0] - gx, oy = eta[1] - gy;
        double x_e = ox * tx[k] + oy * ty[k], y_e = tx[k] * oy - ty[k] * ox;
        if (progress >= path) {
            double far = length2(ox, oy), fastest = least(s->cruise, sqrt(at * at + 2 * brake * far) - at);
            double gain = least(g->k_v / 3, fastest / most(far, 1e-3));
            wish[0] = -ox * gain, wish[1] = -oy * gain;
        } else {
            double slant = sqrt(y_e * y_e + g->lookahead * g->lookahead) / g->lookahead;
            double go = least(most(s->cruise - g->k1 * x_e, 0), s->cap / slant), across = -go * y_e / g->lookahead;
            wish[0] = go * tx[k] - across * ty[k], wish[1] = go * ty[k] + across * tx[k];
        }
        double heading = atan2(ty[k], tx[k]);
        progress = least(progress + s->dt * s->cruise * clip(2 * (1 + x_e / g->wait), 0, 1), path);

        /* obstacles on the course */
        Sector sector[SECTORS];
        int sectors = 0;
        for (int i = 0; i < told; i++) {
            double *row = known[i], dx = row[0] - eta[0], dy = row[1] - eta[1], distance = length2(dx, dy);
            int apart = distance > 1e-6;
            Sector *sec = &sector[sectors++];
            sec->nx = apart ? dx / distance : 1, sec->ny = apart ? dy / distance : 0;
            double free = distance - row[2] - s->model_hull, closing = row[3] * sec->nx + row[4] * sec->ny;
            sec->px = eta[0] + (free + s->model_hull) * sec->nx, sec->py = eta[1] + (free + s->model_hull) * sec->ny;
            free -= g->margin + g->reaction * most(-closing, 0);
            sec->bound = closing + (free >= 0 ? sqrt(at * at + 2 * brake * free) - at : free / g->reaction);
        }
        if (sonar)
            for (int i = 0; i < SENSORS; i++) {
                Filter *f = &filter[i];
                f->age = least(f->age + s->dt, 0.5 + s->dt);
                if (fresh[i]) {
                    double range = range_of(f, samples[i], g), axis[2];
                    turned(i, c, sn, axis);
                    double hx = eta[0] + s->model_hull * axis[0], hy = eta[1] + s->model_hull * axis[1];
                    fresh[i] = 0;
                    if (f->refused < 3 && range < FARTHEST - 0.1 && range < expected(s, axis, hx, hy, known, told) - 0.1) {
                        f->age = 0;
                        f->echo[0] = eta[0] + (s->model_hull + range) * axis[0];
                        f->echo[1] = eta[1] + (s->model_hull + range) * axis[1];
                    }
                }
                if (f->age > 0.5 + 0.5 * s->dt) continue;
                double dx = f->echo[0] - eta[0], dy = f->echo[1] - eta[1], distance = length2(dx, dy);
                int apart = distance > 1e-6;
                Sector *sec = &sector[sectors++];
                sec->nx = apart ? dx / distance : 1, sec->ny = apart ? dy / distance : 0;
                sec->px = eta[0] + distance * sec->nx, sec->py = eta[1] + distance * sec->ny;
                double free = distance - s->model_hull - g->margin;
                sec->bound = free >= 0 ? sqrt(at * at + 2 * brake * free) - at : free / g->reaction;
            }
        double wall_at[4] = {eta[0], s->length - eta[0], eta[1], s->width - eta[1]};
        for (int i = 0; i < 4; i++) {
            Sector *sec = &sector[sectors++];
            sec->nx = i == 0 ? -1 : i == 1 ? 1 : 0, sec->ny = i == 2 ? -1 : i == 3 ? 1 : 0;
            sec->px = eta[0] + wall_at[i] * sec->nx, sec->py = eta[1] + wall_at[i] * sec->ny;
            double free = wall_at[i] - s->model_hull - g->margin;
            sec->bound = free >= 0 ? sqrt(at * at + 2 * brake * free) - at : free / g->reaction;
        }

        /* priority: velocity, then depth, then heading */
        double velocity[2];
        int avoiding = choose(s, wish, sector, sectors, &latch, velocity);
        brake_beyond(c * x[4] - sn * x[5], sn * x[4] + c * x[5], sector, sectors, velocity);
        wanted[0] = c * velocity[0] + sn * velocity[1], wanted[1] = -sn * velocity[0] + c * velocity[1];
        double off = heading - eta[3];
        wanted[2] = g->k2 * (s->depth - eta[2]);
        wanted[3] = g->k_psi * (off - 6.283185307179586 * floor((off + 3.141592653589793) / 6.283185307179586));
        if ((int)s->projected) {
            double task[2] = {wanted[0], wanted[1]};
            project(s, task, sector, sectors, c, sn, wanted);
        }

        /* velocity loop */
        double speed = length2(wanted[0], wanted[1]), shrink = least(1, s->cap / most(speed, 1e-6));
        int clipped = 0;
        wanted[0] *= shrink, wanted[1] *= shrink;
        wanted[2] = clip(wanted[2], -0.1, 0.1), wanted[3] = clip(wanted[3], -turn, turn);
        for (int i = 0; i < 4; i++) {
            double miss = wanted[i] - x[4 + i], drag = (m->linear[i] + m->quadratic[i] * fabs(wanted[i])) * wanted[i];
            double free = drag + m->mass[i] * ((i == 3 ? g->k_r : g->k_v) * miss + integral[i]);
            tau[i] = clip(free, -m->limit[i], m->limit[i]);
            if (fabs(free - tau[i]) > 1e-9) clipped = 1;
            else integral[i] += s->dt * g->k_i * miss;
        }
        int sound = isfinite(tau[0] + tau[1] + tau[2] + tau[3] + progress);

        /* metrics */
        double away = away_from_path(s, x[0], x[1]), off_depth = x[2] - s->depth;
        settling = avoiding || (settling && away > 0.1);
        if (!settling) error += away * away + off_depth * off_depth, kept++;
        square += away * away;
        out->max_deviation = most(out->max_deviation, away);
        out->effort += length2(tau[0], tau[1]);
        saturated += clipped;
        double past_x = x[0] - s->target[0], past_y = x[1] - s->target[1], gap = length2(past_x, past_y);
        if (gap <= 1) out->overshoot = most(out->overshoot, past_x * tx[points - 2] + past_y * ty[points - 2]);
        for (int i = 0; i < 4; i++) out->peak = most(out->peak, fabs(tau[i]) / m->limit[i]);
        if (tick > 0) {
            out->length += length2(x[0] - px, x[1] - py);
            for (int i = 0; i < 2; i++) jerk += (tau[i] - last[i]) * (tau[i] - last[i]);
        }
        px = x[0], py = x[1], memcpy(last, tau, sizeof last);

        if (clearance <= 0) stopped = COLLISION;
        else if (gap <= s->reach) stopped = REACHED;
        else if (!sound) stopped = FAULT;
        if (stopped != TIME_LIMIT) break;

        /* plant, and the second firing in the middle of the step */
        for (int half = 0; half < 2; half++) {
            double force[2] = {0, 0}, now = time + half * 0.025;
            if (s->wave_force > 0) {
                double wave = s->wave_force * sin(6.283185307179586 * now / s->wave_period + luck->wave_phase);
                force[0] = wave * luck->wave[0], force[1] = wave * luck->wave[1];
            }
            advance(s, x, tau, force);
            if (half == 0) {
                double between = INFINITY, ex, ey;
                place(s, luck, time + 0.025, shape);
                if (sonar) {
                    fire(s, shape, firing, x, noise + 5, samples[firing]);
                    fresh[firing] = 1, firing = (firing + 1) % SENSORS;
                }
                for (int i = 0; i < count; i++)
                    if (shape[i].there) between = least(between, foot(&shape[i], x[0], x[1], &ex, &ey) - s->hull);
                wall = wall_distance(s, x) - s->hull;
                clear |= wall > 0;
                if (clear) between = least(between, wall);
                nearest_thing = least(nearest_thing, between);
            }
        }
    }
    int last_tick = tick < (int)s->ticks ? tick : (int)s->ticks - 1, rows = last_tick + 1;
    out->reached = stopped == REACHED, out->collided = stopped == COLLISION, out->stopped = stopped;
    out->time = last_tick * s->dt, out->clearance = nearest_thing;
    out->path_error = kept ? sqrt(error / kept) : NAN, out->deviation = sqrt(square / rows);
    out->effort /= rows, out->saturated = (double)saturated / rows;
    out->thrust_rate = rows > 1 ? sqrt(jerk / (rows - 1)) / s->dt : 0;
}

/* `runs` runs of one scene: gains (runs, 17), luck (runs, 3 + 3·16), metrics (runs, 14); returns the number of steps */
double batch(const Scene *scene, long runs, const double *gains, const double *luck, const uint64_t *seed, double *out)
{
    double ticks = 0;
    Jump step = long_jump();
    for (long i = 0; i < runs; i++) {
        Metrics m;
        fly(scene, (const Gains *)(gains + 17 * i), (const Luck *)(luck + 51 * i), &step, seed[i], &m);
        memcpy(out + 14 * i, &m, sizeof m);
        ticks += floor(m.time / scene->dt + 0.5) + 1;
    }
    return ticks;
}

long sizes(int what) { return what == 0 ? sizeof(Scene) : what == 1 ? sizeof(Luck) : sizeof(Metrics); }
