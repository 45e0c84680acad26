/* Steps of symmetric compositions of leapfrogs that begin with a drift, for satellites of an oblate planet: the
   formulas are those of symplectic.py and molniya.py, which are the reference. A block of members stays in the
   cache for a whole step; compilers vectorise the loops over members. */

#include <math.h>

enum { MEMBERS = 32 };
typedef double block[3][MEMBERS];

#define INLINE static inline __attribute__((always_inline))

/* to += weight h from */
INLINE void add(double weight, const double *h, block from, block to) {
    for (int d = 0; d < 3; d++)
        for (int m = 0; m < MEMBERS; m++) to[d][m] += weight * h[m] * from[d][m];
}

/* dp += weight h F(q + dq), with the attraction -mass mu and the oblateness 3/2 J2 r_eq^2 */
INLINE void kick(double weight, double attraction, double oblateness, const double *h, block q,
                 block dq, block dp) {
    for (int m = 0; m < MEMBERS; m++) {
        double x = q[0][m] + dq[0][m], y = q[1][m] + dq[1][m], z = q[2][m] + dq[2][m];
        double inverse = 1.0 / (x * x + y * y + z * z), bulge = oblateness * inverse;
        double planar = 1.0 + bulge * (1.0 - 5.0 * (z * z * inverse));
        double central = weight * h[m] * attraction * inverse * sqrt(inverse);
        dp[0][m] += central * planar * x;
        dp[1][m] += central * planar * y;
        dp[2][m] += central * (planar + 2.0 * bulge) * z;
    }
}

/* Write the states (batch, 6) reached from x after `parts` steps of length h. There are `stages` kicks and
   stages + 1 drifts; h_step is 0 if all members share one step. */
long ahnn_oblate_steps(long batch, long stages, const double *drifts, const double *kicks, double mass,
                       double attraction, double oblateness, long parts, const double *x, const double *h,
                       long h_step, double *out) {
    for (long first = 0; first < batch; first += MEMBERS) {
        block q, p, dq, dp, sum;
        double h_of[MEMBERS];
        for (int m = 0; m < MEMBERS; m++) { /* an incomplete block is filled with copies of the last member */
            long member = first + m < batch ? first + m : batch - 1;
            for (int d = 0; d < 3; d++) q[d][m] = x[6 * member + d], p[d][m] = x[6 * member + 3 + d];
            h_of[m] = h[member * h_step];
        }
        for (long part = 0; part < parts; part++) {
            for (int d = 0; d < 3; d++)
                for (int m = 0; m < MEMBERS; m++) dq[d][m] = dp[d][m] = 0.0;
            add(drifts[0] / mass, h_of, p, dq);
            for (long i = 0; i < stages; i++) {
                kick(kicks[i], attraction, oblateness, h_of, q, dq, dp);
                for (int d = 0; d < 3; d++)
                    for (int m = 0; m < MEMBERS; m++) sum[d][m] = p[d][m] + dp[d][m];
                add(drifts[i + 1] / mass, h_of, sum, dq);
            }
            for (int d = 0; d < 3; d++)
                for (int m = 0; m < MEMBERS; m++) q[d][m] += dq[d][m], p[d][m] += dp[d][m];
        }
        for (int m = 0; m < MEMBERS && first + m < batch; m++)
            for (int d = 0; d < 3; d++)
                out[6 * (first + m) + d] = q[d][m], out[6 * (first + m) + 3 + d] = p[d][m];
    }
    return 0;
}

/* Constants of a flow; steps longer than `longest` are subdivided. */
typedef struct {
    long stages;
    const double *drifts, *kicks;
    double mass, attraction, oblateness, longest;
} oblate;

/* Write the states (batch, 6) reached from x after dt, in equal steps whose number is that of substeps.py. */
long ahnn_oblate_flow(const oblate *of, long batch, const double *x, double dt, double *out) {
    double parts = ceil(fabs(dt) / of->longest - 1e-9), h;
    if (!(parts >= 1.0)) parts = 1.0;
    h = dt / parts;
    return ahnn_oblate_steps(batch, of->stages, of->drifts, of->kicks, of->mass, of->attraction, of->oblateness,
                             (long)parts, x, &h, 0, out);
}
