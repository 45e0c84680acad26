/* Matrices with rows padded to whole vectors: products, packing and unpacking; for vectors see lanes.h. */

/* Rows and vectors in a tile of a product, whose sums fill the registers. */
enum { ROWS = 4, ACROSS = BYTES == 64 ? 4 : 2 };

#define AT(array, i) (*(lanes *)((array) + (i)))
#define EACH(i, count) for (long i = 0; i < (count); i += LANES)

INLINE long filled(long count, long by) { return (count + by - 1) / by * by; }

/* Compute a tile of C = start + A B; `across`, its width in vectors, is a compile-time constant. */
INLINE void tile(long across, const real *a, long row, long column, const real *b, long length, long inner,
                 const real *start, long start_row, real *c) {
    lanes sum[ROWS][ACROSS];
    for (long r = 0; r < ROWS; r++)
        for (long v = 0; v < across; v++) sum[r][v] = AT(start, r * start_row + v * LANES);
    for (long k = 0; k < inner; k++)
        for (long r = 0; r < ROWS; r++)
            for (long v = 0; v < across; v++)
                sum[r][v] += a[r * row + k * column] * AT(b, k * length + v * LANES);
    for (long r = 0; r < ROWS; r++)
        for (long v = 0; v < across; v++) AT(c, r * length + v * LANES) = sum[r][v];
}

/* Compute C = start + A B, with A(r, k) at a[r row + k column], rows of B and C of size `length`, and a number of
   rows that is a multiple of ROWS. */
static void product(const real *a, long row, long column, const real *b, long length, long rows, long inner,
                    const real *start, long start_row, real *c) {
    for (long j = 0; j < length;) {
        long across = length - j >= ACROSS * LANES ? ACROSS : 1;
        for (long r = 0; r < rows; r += ROWS) {
            const real *from = a + r * row, *with = start + r * start_row + j;
            real *to = c + r * length + j;
            if (across == 1) tile(1, from, row, column, b + j, length, inner, with, start_row, to);
            else tile(ACROSS, from, row, column, b + j, length, inner, with, start_row, to);
        }
        j += across * LANES;
    }
}

/* Copy a matrix (rows, columns), or its transpose, into rows of size `length`, which are zero before. */
static void lay(const real *matrix, long rows, long columns, int turned, long length, real *to) {
    for (long r = 0; r < rows; r++)
        for (long c = 0; c < columns; c++, matrix++) to[turned ? c * length + r : r * length + c] = *matrix;
}

/* Undo `lay`, and return the position of the next matrix. */
static real *lift(const real *from, long rows, long columns, int turned, long length, real *matrix) {
    for (long r = 0; r < rows; r++)
        for (long c = 0; c < columns; c++, matrix++) *matrix = from[turned ? c * length + r : r * length + c];
    return matrix;
}

/* Memory that is handed out piece by piece; without a base, the pieces are only counted. */
typedef struct {
    real *base;
    size_t used;
} arena;

static real *take(arena *from, long count) {
    real *here = from->base ? from->base + from->used : NULL;
    from->used += (size_t)filled(count, LANES);
    return here;
}
