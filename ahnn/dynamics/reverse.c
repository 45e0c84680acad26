/* Increments of explicit Runge-Kutta steps along f = delta_1 E, the gradient of a perceptron times a matrix E, and
   their reverse-mode derivatives, in float, or in double if DOUBLE is defined: the formulas are those of
   gradients.py, which is the reference.

   A block of members passes through all stages, and back, while its numbers stay in the cache. Rows are members
   and lanes are units, so that every product, including sums over members, loads contiguous vectors. Rows of units
   are padded with zeros to whole vectors, and all results in the padding stay zero. */

#include <stdlib.h>
#include <string.h>

#ifndef DOUBLE
#define SINGLE
#endif
#include "lanes.h"
#include "products.h"

/* Bytes used by a block, and the smallest and largest number of its members. */
enum { NEAR = 1 << 18, FEWEST = 8, MOST = 64 };
enum { DONE, NO_MEMORY };
enum { ENTERED, SLOPE, DELTA, BEND, KEPT };

/* A network and its memory layout: rows have `narrow` or `wide` numbers, and a matrix has space for `room` rows;
   matrices are stored as right-hand factors of products. */
typedef struct {
    long size, width, depth, activation, stages, narrow, wide, room, members;
    const real *tableau;
    real *nothing, *up, *bias, *down, *last, *leave, *enter;
} network;

/* Gradients with respect to the parameters of a network; matrices have the shape (inputs, units). */
typedef struct {
    real *weights, *bias, *last, *leave;
} gradients;

/* A stage of a block: its argument, f at this argument, the gradient passed back, and the stored layer values. */
typedef struct {
    real *argument, *f, *pull, *layers;
} stage;

typedef struct {
    real *x, *v, *on_f, *increment, *h, *spare[3], *stages;
} block;

/* to = from B for each member, plus a bias if there is one. */
static void apply(const network *of, const real *from, long from_length, long inner, const real *matrix,
                  const real *bias, real *to, long to_length) {
    product(from, from_length, 1, matrix, to_length, of->members, inner, bias ? bias : of->nothing, 0, to);
}

/* sum += A^T B, summed over members. */
static void gather(const network *of, const real *a, long a_length, long rows, const real *b, real *sum) {
    product(a, 1, a_length, b, of->wide, filled(rows, ROWS), of->members, sum, of->wide, sum);
}

/* sum += rows, summed over members. */
static void gather_rows(const network *of, const real *rows, real *sum) {
    EACH(j, of->wide) {
        lanes total = AT(sum, j);
        for (long m = 0; m < of->members; m++) total += AT(rows, m * of->wide + j);
        AT(sum, j) = total;
    }
}

INLINE real *kept(const network *of, const stage *s, long k, long which) {
    if (which == ENTERED && k == 0) return s->argument;
    return s->layers + (k * KEPT + which) * of->members * of->wide;
}

/* Inputs of layer k: the length of their rows, and the number of inputs without padding. */
INLINE long length_of(const network *of, long k) { return k ? of->wide : of->narrow; }
INLINE long inputs_of(const network *of, long k) { return k ? of->width : of->size; }

/* Compute f at the argument of a stage, and store the values needed by `reverse`. */
static void field(const network *of, const stage *s, real *const *spare) {
    long depth = of->depth, wide = of->wide, all = of->members * wide;
    real *z = spare[0], *u = spare[1];
    for (long k = 0; k < depth; k++) {
        real *slope = kept(of, s, k, SLOPE), *bend = kept(of, s, k, BEND);
        real *value = kept(of, s, k + 1, ENTERED);
        apply(of, kept(of, s, k, ENTERED), length_of(of, k), inputs_of(of, k), of->up + k * of->room * wide,
              of->bias + k * wide, z, wide);
        EACH(i, all) {
            point at = activated(of->activation, AT(z, i));
            AT(slope, i) = at.slope, AT(bend, i) = at.bend;
            if (k + 1 < depth) AT(value, i) = at.value;
        }
    }
    for (long k = depth - 1; k >= 0; k--) {
        real *slope = kept(of, s, k, SLOPE), *delta = kept(of, s, k, DELTA), *bend = kept(of, s, k, BEND);
        for (long m = 0; m < of->members; m++) EACH(j, wide) {
            lanes from = k + 1 < depth ? AT(u, m * wide + j) : AT(of->last, j);
            AT(delta, m * wide + j) = AT(slope, m * wide + j) * from;
            AT(bend, m * wide + j) *= from;
        }
        if (k) apply(of, delta, wide, of->width, of->down + k * of->room * wide, NULL, u, wide);
        else apply(of, delta, wide, of->width, of->leave, NULL, s->f, of->narrow);
    }
}

/* Write v . df/dx of a stage to `pull`, and add v . df/dparameters to the gradients. */
static void reverse(const network *of, const stage *s, const real *v, real *const *spare,
                    const gradients *to) {
    long depth = of->depth, wide = of->wide, all = of->members * wide, matrix = of->room * wide;
    real *along = spare[0], *next = spare[1], *back = spare[2];
    gather(of, v, of->narrow, of->size, kept(of, s, 0, DELTA), to->leave);
    apply(of, v, of->narrow, of->size, of->enter, NULL, along, wide);
    for (long k = 0; k < depth; k++) {
        if (k) {
            gather(of, along, wide, of->width, kept(of, s, k, DELTA), to->weights + k * matrix);
            apply(of, along, wide, of->width, of->up + k * matrix, NULL, next, wide);
            real *before = along;
            along = next, next = before;
        }
        real *bend = kept(of, s, k, BEND), *slope = kept(of, s, k, SLOPE);
        EACH(i, all) AT(bend, i) *= AT(along, i);
        EACH(i, all) AT(along, i) *= AT(slope, i);
    }
    gather_rows(of, along, to->last);
    for (long k = depth - 1; k >= 0; k--) {
        real *here = kept(of, s, k, BEND), *slope = kept(of, s, k, SLOPE);
        if (k + 1 < depth) EACH(i, all) AT(here, i) += AT(back, i) * AT(slope, i);
        const real *entered = kept(of, s, k, ENTERED);
        gather(of, entered, length_of(of, k), inputs_of(of, k), here, to->weights + k * matrix);
        gather_rows(of, here, to->bias + k * wide);
        apply(of, here, wide, of->width, of->down + k * matrix, NULL, k ? back : s->pull, length_of(of, k));
    }
}

/* Size of a stage, in numbers. */
INLINE long apart(const network *of) {
    return of->members * (3 * of->narrow + of->depth * KEPT * of->wide);
}

INLINE stage stage_of(const network *of, const block *b, long i) {
    long row = of->members * of->narrow;
    real *at = b->stages + i * apart(of);
    return (stage){at, at + row, at + 2 * row, at + 3 * row};
}

/* to += sum_k weights[k step] rows_k, where rows_k belongs to stage k. */
static void add(const network *of, long count, const real *weights, long step, const real *rows, real *to) {
    for (long k = 0; k < count; k++, weights += step, rows += apart(of))
        if (*weights != 0) EACH(i, of->members * of->narrow) AT(to, i) += *weights * AT(rows, i);
}

/* Multiply each row by the step of its member. */
static void scale(const network *of, const real *h, real *rows) {
    for (long m = 0; m < of->members; m++) EACH(j, of->narrow) AT(rows, m * of->narrow + j) *= h[m];
}

/* Compute the increment of a block; the stages then contain h f in place of f. */
static void follow(const network *of, const block *b) {
    long count = of->stages;
    size_t row = sizeof(real) * (size_t)(of->members * of->narrow);
    const real *first = stage_of(of, b, 0).f;
    for (long i = 0; i < count; i++) {
        stage s = stage_of(of, b, i);
        memcpy(s.argument, b->x, row);
        add(of, i, of->tableau + i * count, 1, first, s.argument);
        field(of, &s, b->spare);
        scale(of, b->h, s.f);
    }
    memset(b->increment, 0, row);
    add(of, count, of->tableau + count * count, 1, first, b->increment);
}

/* After `follow`, write v . d(increment)/dx of a block in place of the increment. */
static void follow_back(const network *of, const block *b, const gradients *to) {
    long count = of->stages;
    size_t row = sizeof(real) * (size_t)(of->members * of->narrow);
    const real one = 1, *weights = of->tableau + count * count;
    memset(b->increment, 0, row);
    for (long i = count - 1; i >= 0; i--) {
        stage s = stage_of(of, b, i);
        memset(b->on_f, 0, row);
        add(of, 1, weights + i, 1, b->v, b->on_f);
        add(of, count - 1 - i, of->tableau + (i + 1) * count + i, count, s.pull + apart(of), b->on_f);
        scale(of, b->h, b->on_f);
        reverse(of, &s, b->on_f, b->spare, to);
        add(of, 1, &one, 1, s.pull, b->increment);
    }
}

/* Reserve memory for everything except the stages. */
static void place(arena *from, network *of, gradients *to, block *b) {
    long wide = of->wide, narrow = of->narrow, depth = of->depth, matrix = of->room * wide;
    of->up = take(from, depth * matrix), of->down = take(from, depth * matrix);
    of->bias = take(from, depth * wide), of->last = take(from, wide);
    of->leave = take(from, matrix), of->enter = take(from, matrix), of->nothing = take(from, of->room);
    to->weights = take(from, depth * matrix), to->bias = take(from, depth * wide);
    to->last = take(from, wide), to->leave = take(from, matrix);
    long row = of->members * narrow, layers = of->members * wide;
    b->x = take(from, row), b->v = take(from, row), b->on_f = take(from, row), b->increment = take(from, row);
    b->h = take(from, of->members);
    for (long i = 0; i < 3; i++) b->spare[i] = take(from, layers);
}

/* Read the parameters: the matrices of the layers, their biases, the last row, and E. */
static void read(network *of, const real *const *given) {
    long matrix = of->room * of->wide;
    for (long k = 0; k < of->depth; k++) {
        lay(given[k], of->width, inputs_of(of, k), 1, of->wide, of->up + k * matrix);
        lay(given[k], of->width, inputs_of(of, k), 0, length_of(of, k), of->down + k * matrix);
        lay(given[of->depth + k], 1, of->width, 0, of->wide, of->bias + k * of->wide);
    }
    lay(given[2 * of->depth], 1, of->width, 0, of->wide, of->last);
    lay(given[2 * of->depth + 1], of->width, of->size, 0, of->narrow, of->leave);
    lay(given[2 * of->depth + 1], of->width, of->size, 1, of->wide, of->enter);
}

/* Read the members of a block; an incomplete block is filled with copies of the last one, with v = 0. */
static void enter(const network *of, block *b, long left, const real *x, const real *h, long h_step,
                  const real *v) {
    for (long m = 0; m < of->members; m++) {
        long member = m < left ? m : left - 1;
        for (long d = 0; d < of->size; d++) {
            b->x[m * of->narrow + d] = x[member * of->size + d];
            if (v) b->v[m * of->narrow + d] = m < left ? v[member * of->size + d] : 0;
        }
        b->h[m] = h[member * h_step];
    }
}

static void write(const network *of, const gradients *from, real *to) {
    long matrix = of->room * of->wide;
    for (long k = 0; k < of->depth; k++)
        to = lift(from->weights + k * matrix, of->width, inputs_of(of, k), 1, of->wide, to);
    for (long k = 0; k < of->depth; k++) to = lift(from->bias + k * of->wide, 1, of->width, 0, of->wide, to);
    to = lift(from->last, 1, of->width, 0, of->wide, to);
    lift(from->leave, of->width, of->size, 1, of->wide, to);
}

/* Return the number of members in a block whose stages fit in the cache. */
static long members_of(long batch, long apart_for_one, long stages) {
    long members = NEAR / ((long)sizeof(real) * apart_for_one * stages) / ROWS * ROWS;
    members = members < FEWEST ? FEWEST : members > MOST ? MOST : members;
    return members < batch ? members : filled(batch > 0 ? batch : 1, ROWS);
}

static network network_of(long batch, long size, long width, long depth, long activation, long stages) {
    long narrow = filled(size, LANES), wide = filled(width, LANES);
    network of = {.size = size, .width = width, .depth = depth, .activation = activation, .stages = stages};
    of.narrow = narrow, of.wide = wide, of.room = narrow > wide ? narrow : wide, of.members = 1;
    of.members = members_of(batch, apart(&of), stages);
    return of;
}

/* Return how many numbers a batch stores for its reverse pass. */
long ahnn_kept(long batch, long size, long width, long depth, long stages) {
    network of = network_of(batch, size, width, depth, GELU, stages);
    return filled(batch, of.members) / of.members * stages * apart(&of);
}

/* Write the increments (batch, size) of one step from x. If v is given, write v . d(increment)/dx instead, and
   v . d(increment)/dparameters to `sums`, in the order of `given`. The tableau contains one row per stage, then
   the weights of the step, each with `stages` numbers; h_step is 0 if all members share one step. If `records` is
   given, the forward pass stores values there that the reverse pass would otherwise recompute; the reverse pass
   overwrites them. */
long ahnn_increment(long batch, long size, long width, long depth, long activation, long stages,
                    const real *tableau, const real *const *given, const real *x, const real *h, long h_step,
                    const real *v, real *records, real *out, real *sums) {
    network of = network_of(batch, size, width, depth, activation, stages);
    gradients to;
    block b;
    arena from = {NULL, 0};
    of.tableau = tableau;
    place(&from, &of, &to, &b);
    size_t zero = sizeof(real) * from.used, block_of_stages = sizeof(real) * (size_t)(stages * apart(&of));
    from = (arena){aligned_alloc(BYTES, zero + (records ? 0 : block_of_stages)), 0};
    if (!from.base) return NO_MEMORY;
    memset(from.base, 0, zero); /* stages need no zeros: they are written before they are read */
    place(&from, &of, &to, &b);
    b.stages = from.base + from.used;
    read(&of, given);
    for (long first = 0; first < batch; first += of.members) {
        enter(&of, &b, batch - first, x + first * size, h + first * h_step, h_step, v ? v + first * size : NULL);
        if (records) b.stages = records + first / of.members * stages * apart(&of);
        if (!v || !records) follow(&of, &b);
        if (v) follow_back(&of, &b, &to);
        long own = batch - first < of.members ? batch - first : of.members;
        lift(b.increment, own, size, 0, of.narrow, out + first * size);
    }
    if (v) write(&of, &to, sums);
    free(from.base);
    return DONE;
}
