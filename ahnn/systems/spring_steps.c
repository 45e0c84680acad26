/* Steps of the two-stage Gauss-Legendre method for a mass on a spring: the operations of implicit.py and
   mass_spring.py, which are the reference, in their order, so that results have the same bits. */

#include <math.h>

/* A product and a sum that are rounded once would give other bits. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#endif

typedef struct {
    double q, p;
} state;

static inline state field(double stiffness, double mass, state x) {
    state rate = {x.p / mass, -stiffness * x.q};
    return rate;
}

static inline state stage(state x, double h, double own, state k1, double other, state k2) {
    state moved = {x.q + h * (own * k1.q + other * k2.q), x.p + h * (own * k1.p + other * k2.p)};
    return moved;
}

static inline double relative(double shift, double size) { return shift == 0.0 ? 0.0 : shift / size; }

static inline double shifted(double h, double new1, double k1, double new2, double k2) {
    return fabs(h * fmax(fabs(new1 - k1), fabs(new2 - k2)));
}

/* Add one step to x; return 1, with x unchanged, if a value is not finite or no convergence is reached. */
static long step(double stiffness, double mass, double h, double tolerance, double round_off, long most,
                 state *x) {
    const double a12 = 0.25 - sqrt(3.0) / 6.0, a21 = 0.25 + sqrt(3.0) / 6.0;
    state k1 = field(stiffness, mass, *x), k2 = k1;
    double size_q = fmax(fabs(x->q), fabs(h * k1.q)), size_p = fmax(fabs(x->p), fabs(h * k1.p));
    double previous = INFINITY;
    for (long sweep = 0; sweep < most; sweep++) {
        state new1 = field(stiffness, mass, stage(*x, h, 0.25, k1, a12, k2));
        state new2 = field(stiffness, mass, stage(*x, h, a21, k1, 0.25, k2));
        double shift_q = shifted(h, new1.q, k1.q, new2.q, k2.q);
        double shift_p = shifted(h, new1.p, k1.p, new2.p, k2.p);
        double of_q, of_p, change;
        k1 = new1, k2 = new2;
        size_q = fmax(size_q, fabs(h * k1.q)), size_p = fmax(size_p, fabs(h * k1.p));
        of_q = relative(shift_q, size_q), of_p = relative(shift_p, size_p);
        if (!(isfinite(of_q) && isfinite(of_p))) return 1;
        change = fmax(of_q, of_p);
        if ((shift_q <= tolerance * size_q && shift_p <= tolerance * size_p) ||
            (change >= previous && change <= round_off)) {
            x->q += 0.5 * h * (k1.q + k2.q), x->p += 0.5 * h * (k1.p + k2.p);
            return 0;
        }
        previous = change;
    }
    return 1;
}

/* Write the states (batch, 2) reached from x after `parts` steps of length h; return 1 if one of them fails. */
long ahnn_spring_steps(long batch, double stiffness, double mass, double tolerance, double round_off, long most,
                       long parts, double h, const double *x, double *out) {
    for (long b = 0; b < batch; b++) {
        state own = {x[2 * b], x[2 * b + 1]};
        for (long part = 0; part < parts; part++)
            if (step(stiffness, mass, h, tolerance, round_off, most, &own)) return 1;
        out[2 * b] = own.q, out[2 * b + 1] = own.p;
    }
    return 0;
}
