/* The chain of piezod/operators in C, on the same packed array: [plays, zones, offset | r, w, z | r, w]. */

#include <stddef.h>

enum { HEADER = 3 };

static double play_step(double *packed, ptrdiff_t count, double u)
{
    const double *r = packed, *w = packed + count;
    double *z = packed + 2 * count, v = 0.0;
    for (ptrdiff_t i = 0; i < count; i++) {
        double upper = u + r[i], lower = u - r[i];
        double moved = z[i] < upper ? z[i] : upper;
        moved = moved > lower ? moved : lower;
        z[i] = moved;
        v += w[i] * moved;
    }
    return v;
}

static double play_solve(const double *packed, ptrdiff_t count, double v)
{
    const double *r = packed, *w = packed + count, *z = packed + 2 * count;
    double missing = v;
    for (ptrdiff_t i = 0; i < count; i++)
        missing -= w[i] * z[i];
    double sign = missing >= 0.0 ? 1.0 : -1.0, position = z[0], slope = w[0];
    missing *= sign;
    for (ptrdiff_t i = 1; i < count; i++) {
        double kink = z[i] + sign * r[i];
        double rise = slope * (kink - position) * sign;
        if (missing <= rise)
            break;
        missing -= rise;
        position = kink;
        slope += w[i];
    }
    return position + sign * missing / slope;
}

static double dead_zone_step(const double *packed, ptrdiff_t count, double x)
{
    double y = 0.0;
    for (ptrdiff_t j = 0; j < count; j++) {
        double r = packed[j], beyond = x - r;
        if (r == 0.0 || (r > 0.0) == (beyond > 0.0))
            y += packed[count + j] * beyond;
    }
    return y;
}

void forward_run(double *packed, const double *u, double *y, ptrdiff_t size)
{
    for (ptrdiff_t k = 0; k < size; k++) {
        ptrdiff_t plays = (ptrdiff_t)packed[0], zones = (ptrdiff_t)packed[1];
        double v = play_step(packed + HEADER, plays, u[k]);
        y[k] = dead_zone_step(packed + HEADER + 3 * plays, zones, v) + packed[2];
    }
}

void plan_run(double *packed, const double *y, double *u, ptrdiff_t size)
{
    for (ptrdiff_t k = 0; k < size; k++) {
        ptrdiff_t plays = (ptrdiff_t)packed[0], zones = (ptrdiff_t)packed[1];
        double v = dead_zone_step(packed + HEADER + 3 * plays, zones, y[k] - packed[2]);
        u[k] = play_solve(packed + HEADER, plays, v);
    }
}

void commit_run(double *packed, const double *u, double *v, ptrdiff_t size)
{
    for (ptrdiff_t k = 0; k < size; k++)
        v[k] = play_step(packed + HEADER, (ptrdiff_t)packed[0], u[k]);
}
