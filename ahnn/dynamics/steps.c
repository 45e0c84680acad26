/* Steps of explicit Runge-Kutta methods along f = delta_1 E, the gradient of a perceptron that leaves by a
   matrix E: the formulas are those of gradients.py, which is the reference.

   A block of members does a whole step while its numbers stay in the cache; within it the last index is the
   member. What no longer changes comes as one array, see steady.py: a matrix in panels of ROWS rows, column by
   column, the last panel filled up with zeros. A number that is not finite stays in its lane. */

#include <stdlib.h>

#include "lanes.h"

#define ROWS 8 /* of a panel; steady.py has the same number */
/* Vectors of a block, and rows of a panel at once: their sums fill the registers. */
enum { VECTORS = 2, PART = BYTES == 64 ? 8 : 4 };
#define MEMBERS (LANES * VECTORS)

typedef lanes block[VECTORS];

enum { DONE, NO_MEMORY };

static void activate(long activation, long width, const block *z, block *value, block *slope) {
    for (long i = 0; i < width; i++)
        for (long v = 0; v < VECTORS; v++) {
            point at = activated(activation, z[i][v]);
            value[i][v] = at.value, slope[i][v] = at.slope;
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
