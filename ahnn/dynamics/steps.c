/* Steps of explicit Runge-Kutta methods along f = delta_1 E, the gradient of a perceptron that leaves by a
   matrix E: the formulas are those of gradients.py, which is the reference.

   A block of members does a whole step while its numbers stay in the cache; within it the last index is the
   member. What no longer changes comes as one array, see steady.py: a matrix in panels of ROWS rows, column by
   column, the last panel filled up with zeros. A number that is not finite stays in its lane. */

#include <stdlib.h>

#define INLINE static inline __attribute__((always_inline))
#define ROWS 8 /* of a panel; steady.py has the same number */
/* Members in a vector, vectors of a block, and rows of a panel at once: their sums fill the registers. */
#if defined(__AVX512F__)
enum { LANES = 8, VECTORS = 2, PART = 8 };
#elif defined(__AVX2__)
enum { LANES = 4, VECTORS = 2, PART = 4 };
#else
enum { LANES = 2, VECTORS = 2, PART = 4 };
#endif
#define MEMBERS (LANES * VECTORS)

typedef double lanes __attribute__((vector_size(8 * LANES), may_alias));
typedef long long bits __attribute__((vector_size(8 * LANES), may_alias));
typedef lanes block[VECTORS];

enum { GELU, TANH, SILU };
enum { DONE, NO_MEMORY };

INLINE lanes pick(bits where, lanes yes, lanes no) {
    return (lanes)((where & (bits)yes) | (~where & (bits)no));
}

/* exp(x) for x <= 0: the Taylor series of the remainder from the nearest multiple of log 2 (log 2 in two parts,
   Cody & Waite 1980). Below -708 it is exp(-708) in place of a denormal number. */
INLINE lanes exponential(lanes x) {
    static const double inverse[] = {1.0 / 6227020800, 1.0 / 479001600, 1.0 / 39916800, 1.0 / 3628800,
                                     1.0 / 362880,     1.0 / 40320,     1.0 / 5040,     1.0 / 720,
                                     1.0 / 120,        1.0 / 24,        1.0 / 6,        0.5,
                                     1.0,              1.0};
    const lanes round = (lanes){} + 6755399441055744.0, least = (lanes){} - 708.0; /* 1.5 2^52 */
    const bits one = (bits){} + 0x3ff0000000000000LL;
    x = pick(x < least, least, x);
    lanes shifted = x * 1.4426950408889634 + round, whole = shifted - round;
    lanes r = x - whole * 6.93147180369123816490e-01;
    r = r - whole * 1.90821492927058770002e-10;
    lanes sum = (lanes){} + inverse[0];
    for (int k = 1; k < 14; k++) sum = sum * r + inverse[k];
    return sum * (lanes)(((bits)shifted << 52) + one);
}

/* z Phi(z) and its slope Phi(z) + z phi(z). With t = |z| the tail 1 - Phi(t) is exp(-t^2 / 2) P(q) / (t + 4.5),
   q = (t - 4.5) / (t + 4.5) (Shepherd & Laframboise 1981, Math. Comp. 36, 249). P is the Chebyshev series of
   degree 22, summed by powers: its remainder is 3e-17 of its largest term. */
INLINE void gelu(lanes z, lanes *value, lanes *slope) {
    static const double tail[] = {
        1.0440252036819998e-09, 2.662280765855698e-10,  -1.1251292724707997e-08, -6.170870319722238e-09,
        7.060212865222912e-08,  6.605207817943098e-08,  -3.7926071995466557e-07, -5.037449540432435e-07,
        2.1426759805083802e-06, 3.192063301118266e-06,  -1.423571236638514e-05,  -1.59337294151542e-05,
        0.00011204260719214357, 6.381295655218961e-06,  -0.0009177464773392233,  0.0017488305479398012,
        0.004223613376799493,   -0.033871326175605156,  0.11138259657043223,     -0.2531417999510249,
        0.4464525170556733,     -0.6402577602526165,    0.7632305289702032};
    const lanes zero = {}, far = (lanes){} + 37.0; /* beyond it numbers are denormal, and slow */
    lanes t = pick(z < zero, -z, z);
    t = pick(t > far, far, t);
    lanes inverse = 1.0 / (t + 4.5), q = (t - 4.5) * inverse, sum = (lanes){} + tail[0];
    for (int k = 1; k < 23; k++) sum = sum * q + tail[k];
    lanes e = exponential(-0.5 * t * t), above = e * sum * inverse;
    lanes cumulative = pick(z < zero, above, 1.0 - above);
    *value = z * cumulative;
    *slope = cumulative + z * (0.3989422804014327 * e);
}

/* Of both, the exponential of -|z| keeps what is small. */
INLINE void tanh_(lanes z, lanes *value, lanes *slope) {
    const lanes zero = {};
    lanes e = exponential(pick(z < zero, 2.0 * z, -2.0 * z)), inverse = 1.0 / (1.0 + e);
    lanes size = (1.0 - e) * inverse;
    *value = pick(z < zero, -size, size);
    *slope = 4.0 * e * inverse * inverse;
}

INLINE void silu(lanes z, lanes *value, lanes *slope) {
    const lanes zero = {};
    lanes e = exponential(pick(z < zero, z, -z)), larger = 1.0 / (1.0 + e), smaller = e * larger;
    lanes logistic = pick(z < zero, smaller, larger);
    *value = z * logistic;
    *slope = logistic + *value * pick(z < zero, larger, smaller);
}

static void activate(long activation, long width, const block *z, block *value, block *slope) {
    for (long i = 0; i < width; i++)
        for (long v = 0; v < VECTORS; v++) switch (activation) {
            case GELU: gelu(z[i][v], &value[i][v], &slope[i][v]); break;
            case TANH: tanh_(z[i][v], &value[i][v], &slope[i][v]); break;
            default: silu(z[i][v], &value[i][v], &slope[i][v]);
            }
}

INLINE long panels(long rows) { return (rows + ROWS - 1) / ROWS; }

/* to = matrix from, plus bias where there is one; `to` has room for whole panels. */
static void multiply(const double *matrix, const double *bias, long rows, long columns, const block *from,
                     block *to) {
    for (long p = 0; p < panels(rows); p++, matrix += ROWS * columns)
        for (long part = 0; part < ROWS; part += PART) {
            lanes sum[PART][VECTORS];
            for (long r = 0; r < PART; r++)
                for (long v = 0; v < VECTORS; v++)
                    sum[r][v] = (lanes){} + (bias ? bias[p * ROWS + part + r] : 0.0);
            for (long c = 0; c < columns; c++)
                for (long r = 0; r < PART; r++)
                    for (long v = 0; v < VECTORS; v++)
                        sum[r][v] += matrix[c * ROWS + part + r] * from[c][v];
            for (long r = 0; r < PART; r++)
                for (long v = 0; v < VECTORS; v++) to[p * ROWS + part + r][v] = sum[r][v];
        }
}

typedef struct {
    long size, width, depth, activation;
    const double *constants;
} network;

/* The field f at x, both (size), for a block. */
static void field(const network *of, const block *x, block *f, block *z, block *value, block *slopes) {
    long wide = panels(of->width) * ROWS, narrow = panels(of->size) * ROWS;
    const double *at = of->constants;
    for (long k = 0; k < of->depth; k++) {
        long columns = k ? of->width : of->size;
        multiply(at, at + wide * columns, of->width, columns, k ? value : x, z);
        activate(of->activation, of->width, z, value, slopes + k * wide);
        at += wide * columns + wide;
    }
    block *delta = slopes + (of->depth - 1) * wide;
    for (long i = 0; i < of->width; i++)
        for (long v = 0; v < VECTORS; v++) delta[i][v] *= at[i];
    at += wide;
    for (long k = of->depth - 1; k > 0; k--, at += wide * of->width) {
        multiply(at, NULL, of->width, of->width, delta, z);
        delta -= wide;
        for (long i = 0; i < of->width; i++)
            for (long v = 0; v < VECTORS; v++) delta[i][v] *= z[i][v];
    }
    multiply(at, NULL, of->size, of->width, delta, z);
    for (long i = 0; i < narrow; i++)
        for (long v = 0; v < VECTORS; v++) f[i][v] = z[i][v];
}

/* to = base + h sum_i weights_i slopes_i; slopes of zero weight are not touched. */
static void moved(const block *base, const double *weights, long count, long size, long step, const lanes *h,
                  const block *slopes, block *to) {
    for (long d = 0; d < size; d++)
        for (long v = 0; v < VECTORS; v++) {
            lanes sum = {};
            for (long i = 0; i < count; i++)
                if (weights[i] != 0.0) sum += weights[i] * slopes[i * step + d][v];
            to[d][v] = base[d][v] + h[v] * sum;
        }
}

/* Write the states (batch, size) one step behind the states x. The tableau has the rows of stages, then the
   weights of the step, each `stages` long; h_step is 0 where all members share one step. */
long ahnn_step(long batch, long size, long width, long depth, long activation, long stages,
               const double *tableau, const double *constants, const double *x, const double *h, long h_step,
               double *out) {
    network of = {size, width, depth, activation, constants};
    long wide = panels(width) * ROWS, narrow = panels(size) * ROWS, room = wide > narrow ? wide : narrow;
    size_t bytes = sizeof(block) * (size_t)((depth + 2) * room + (stages + 2) * narrow);
    block *z = aligned_alloc(64, (bytes + 63) & ~(size_t)63);
    if (!z) return NO_MEMORY;
    block *value = z + room, *slopes = value + room, *here = slopes + depth * room;
    block *there = here + narrow, *fields = there + narrow;
    for (long first = 0; first < batch; first += MEMBERS) {
        lanes h_of[VECTORS];
        for (long m = 0; m < MEMBERS; m++) { /* lanes that are left over repeat the last member */
            long member = first + m < batch ? first + m : batch - 1;
            for (long d = 0; d < size; d++) here[d][m / LANES][m % LANES] = x[member * size + d];
            h_of[m / LANES][m % LANES] = h[member * h_step];
        }
        for (long i = 0; i < stages; i++) {
            moved(here, tableau + i * stages, i, size, narrow, h_of, fields, there);
            field(&of, there, fields + i * narrow, z, value, slopes);
        }
        moved(here, tableau + stages * stages, stages, size, narrow, h_of, fields, there);
        for (long m = 0; m < MEMBERS && first + m < batch; m++)
            for (long d = 0; d < size; d++) out[(first + m) * size + d] = there[d][m / LANES][m % LANES];
    }
    free(z);
    return DONE;
}
