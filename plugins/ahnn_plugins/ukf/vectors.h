/* Operations on LANES members at once, and triangular factors of their matrices.

   Within a block of members the last index is the member. Non-finite numbers do not spread to other members. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define LANES 4
#define INLINE static inline __attribute__((always_inline))
#if defined(__x86_64__) && defined(__linux__) && !defined(__clang__) && __GNUC__ >= 12
#define KERNEL __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define KERNEL
#endif

typedef double lanes __attribute__((vector_size(8 * LANES), may_alias));
typedef long long bits __attribute__((vector_size(8 * LANES), may_alias));

INLINE lanes pick(bits where, lanes yes, lanes no) {
    return (lanes)((where & (bits)yes) | (~where & (bits)no));
}

INLINE lanes root(lanes x) {
    for (long l = 0; l < LANES; l++) x[l] = sqrt(x[l]);
    return x;
}

/* Divide each column of `a` by the power of two that brings its largest entry near one: the division is exact, and
   no square overflows or underflows. */
INLINE void balance(lanes *restrict a, lanes *restrict scale, long rows, long columns) {
    const bits exponent = (bits){} + 0x7ff0000000000000LL, sign = (bits){} + (-0x7fffffffffffffffLL - 1);
    const lanes one = (lanes){} + 1.0;
    for (long c = 0; c < columns; c++) {
        lanes *column = a + c * rows, largest = {};
        for (long i = 0; i < rows; i++) {
            lanes size = (lanes)((bits)column[i] & ~sign);
            for (long l = 0; l < LANES; l++) largest[l] = size[l] > largest[l] ? size[l] : largest[l];
        }
        lanes power = (lanes)((bits)largest & exponent);
        scale[c] = pick(power == (lanes){}, one, power);
        lanes inverse = one / scale[c];
        for (long i = 0; i < rows; i++) column[i] *= inverse;
    }
}

/* Householder QR of `a` (rows, columns), stored by columns: R, with diagonal >= 0, replaces its upper part. */
INLINE void triangularise(lanes *a, long rows, long columns) {
    const bits sign = (bits){} + (-0x7fffffffffffffffLL - 1);
    const lanes one = (lanes){} + 1.0;
    for (long j = 0; j < columns; j++) {
        lanes *restrict v = a + j * rows, pivot = v[j], square = pivot * pivot;
        for (long i = j + 1; i < rows; i++) square += v[i] * v[i];
        lanes norm = root(square), size = (lanes)((bits)pivot & ~sign);
        bits zero = norm == (lanes){};
        lanes towards = (lanes)((bits)one | ((bits)pivot & sign)), head = pivot + towards * norm;
        lanes factor = pick(zero, norm, one / (norm * (norm + size)));
        lanes turn = pick(zero, towards, -towards);
        for (long c = j + 1; c < columns; c++) {
            lanes *restrict column = a + c * rows, product = head * column[j];
            for (long i = j + 1; i < rows; i++) product += v[i] * column[i];
            product *= factor;
            column[j] = turn * (column[j] - product * head);
            for (long i = j + 1; i < rows; i++) column[i] -= product * v[i];
        }
        v[j] = norm;
    }
}

/* Indices of the members in a block. An incomplete block is filled with copies of the last member. */
typedef struct {
    long member[LANES], count;
} block;

INLINE block block_at(long first, long batch) {
    block here;
    here.count = batch - first < LANES ? batch - first : LANES;
    for (long l = 0; l < LANES; l++) here.member[l] = first + (l < here.count ? l : here.count - 1);
    return here;
}

/* Load entry k of each member's array. */
INLINE lanes load(const double *from, const block *here, long step, long k) {
    lanes x;
    for (long l = 0; l < LANES; l++) x[l] = from[here->member[l] * step + k];
    return x;
}

INLINE void save(double *to, const block *here, long step, long k, lanes x) {
    for (long l = 0; l < here->count; l++) to[here->member[l] * step + k] = x[l];
}

/* Write the lower factor (columns, columns) from a triangularised matrix; return whether all variances are positive
   and finite. */
INLINE long save_factor(double *to, const block *here, const lanes *a, const lanes *scale, long rows,
                        long columns) {
    const lanes zero = {};
    long sound = 1;
    for (long c = 0; c < columns; c++) {
        lanes variance = zero;
        for (long r = 0; r < columns; r++) {
            lanes entry = zero;
            if (r <= c) entry = a[c * rows + r] * scale[c];
            variance += entry * entry;
            save(to, here, columns * columns, c * columns + r, entry);
        }
        for (long l = 0; l < LANES; l++) sound &= variance[l] > 0.0 && variance[l] < INFINITY;
    }
    return sound;
}

static lanes *workspace(long count) { return aligned_alloc(sizeof(lanes), sizeof(lanes) * (size_t)count); }
