/* The square-root filter, with each operation applied to LANES members at once.

   Arrays are float64 and row-major with the member as first index, as in torch; a step of 0 between members
   means that they share a matrix. The formulas are those of square_root.py, which is the reference. */

#include "vectors.h"

static const double EPS = 2.220446049250313e-16;
/* Largest tolerated rounding error, in standard deviations, as in rounding.py. */
static const double LIMIT = 1e-3;
static const double LOG_TWO_PI = 1.8378770664093453;

/* Return values of the functions. */
enum { SOUND, UNSOUND, NO_MEMORY, NO_FLOW };

/* Write sigma points (batch, 2 size + 1, size): the mean, and the mean plus and minus radius times each column of
   the factor. */
KERNEL long ahnn_draw(long batch, long size, const double *mean, const double *chol, long chol_step,
                      const double *radius, long weight_step, double *points) {
    for (long b = 0; b < batch; b++) {
        const double *m = mean + b * size, *l = chol + b * chol_step;
        double *p = points + b * (2 * size + 1) * size, r = radius[b * weight_step];
        for (long c = 0; c < size; c++) {
            p[c] = m[c];
            for (long i = 0; i < size; i++) {
                double spread = r * l[c * size + i];
                p[(1 + i) * size + c] = m[c] + spread;
                p[(1 + size + i) * size + c] = m[c] - spread;
            }
        }
    }
    return SOUND;
}

/* Write the mean and lower factor of propagated points (batch, 2 size + 1, size), including process noise. */
KERNEL long ahnn_predict(long batch, long size, const double *points, const double *outer,
                         const double *recentring, long weight_step, const double *chol_q, long q_step,
                         double *mean, double *chol) {
    long pairs = 2 * size, rows = pairs + size, step = (pairs + 1) * size;
    long sound = 1;
    lanes *a = workspace((rows + 1) * size), *scale = a + rows * size;
    if (!a) return NO_MEMORY;
    for (long first = 0; first < batch; first += LANES) {
        block here = block_at(first, batch);
        lanes weight = load(outer, &here, weight_step, 0), kept = load(recentring, &here, weight_step, 0);
        lanes half = root(weight);
        for (long c = 0; c < size; c++) {
            lanes *column = a + c * rows, centre = load(points, &here, step, c), sum = {};
            for (long i = 0; i < pairs; i++) {
                column[i] = load(points, &here, step, (1 + i) * size + c) - centre;
                sum += column[i];
            }
            lanes shift = weight * sum, lost = kept * shift;
            for (long i = 0; i < pairs; i++) column[i] = half * (column[i] - lost);
            for (long i = 0; i < size; i++) column[pairs + i] = load(chol_q, &here, q_step, c * size + i);
            save(mean, &here, size, c, centre + shift);
        }
        balance(a, scale, rows, size);
        triangularise(a, rows, size);
        sound &= save_factor(chol, &here, a, scale, rows, size);
    }
    free(a);
    return sound ? SOUND : UNSOUND;
}

/* Write the joint lower factor (batch, width + size, width + size) of measurement and state, and the mean of
   `images` (batch, 2 size, width), which are relative to the image of the centre. NaN in y means missing. */
KERNEL long ahnn_joint(long batch, long size, long width, const double *images, const double *y, long complete,
                       const double *prior, long prior_step, const double *outer, const double *recentring,
                       long weight_step, const double *chol_r, long r_step, double *shifts, double *joint) {
    long pairs = 2 * size, columns = width + size, rows = pairs + (complete ? width : 2 * width);
    lanes *a = workspace((rows + 1) * columns), *scale = a + rows * columns;
    if (!a) return NO_MEMORY;
    for (long first = 0; first < batch; first += LANES) {
        block here = block_at(first, batch);
        lanes weight = load(outer, &here, weight_step, 0), kept = load(recentring, &here, weight_step, 0);
        lanes half = root(0.5 * weight), one = (lanes){} + 1.0;
        memset(a, 0, sizeof(lanes) * (size_t)(rows * columns));
        for (long c = 0; c < width; c++) {
            lanes *column = a + c * rows, told = load(y, &here, width, c), sum = {};
            bits there = told == told;
            for (long i = 0; i < pairs; i++) {
                column[i] = pick(there, load(images, &here, pairs * width, i * width + c), (lanes){});
                sum += column[i];
            }
            lanes shift = weight * sum, lost = kept * shift;
            for (long i = 0; i < size; i++) {
                lanes plus = half * (column[i] - lost), minus = half * (column[size + i] - lost);
                column[i] = plus - minus;
                column[size + i] = plus + minus;
            }
            for (long i = 0; i < width; i++)
                column[pairs + i] = pick(there, load(chol_r, &here, r_step, c * width + i), (lanes){});
            if (!complete) column[pairs + width + c] = pick(there, (lanes){}, one);
            save(shifts, &here, width, c, shift);
        }
        for (long c = 0; c < size; c++)
            for (long i = 0; i < size; i++)
                a[(width + c) * rows + i] = load(prior, &here, prior_step, c * size + i);
        balance(a, scale, rows, columns);
        triangularise(a, rows, columns);
        save_factor(joint, &here, a, scale, rows, columns);
    }
    free(a);
    return SOUND;
}

/* Results of an update for each member. */
typedef struct {
    double *residuals, *mean, *chol, *deviations, *nis, *log_likelihood;
    unsigned char *singular;
} told;

/* Compute the posterior of member b from its joint factor and the residuals of y, and set the residuals of missing
   components to zero. Return whether no component is missing or singular, all results are finite, and rounding
   errors are below LIMIT. `noise` is the factor of R, and `work` has space for 2 width numbers. */
INLINE long condition(long b, long size, long width, const double *factor, const double *y, const double *prior,
                      const double *noise, const told *to, double *work) {
    long columns = width + size, precise = 1;
    double *residual = to->residuals + b * width, squares = 0.0, logs = 0.0, there = 0.0;
    double *white = work, *off = work + width, lost = 0.0;
    to->singular[b] = 0;
    for (long i = 0; i < width; i++) {
        const double *row = factor + i * columns;
        double norm = 0.0, rest;
        if (isnan(y[b * width + i])) residual[i] = 0.0;
        else there += 1.0;
        rest = residual[i];
        for (long k = 0; k < i; k++) rest -= row[k] * white[k];
        for (long k = 0; k <= i; k++) norm += row[k] * row[k];
        norm = to->deviations[b * width + i] = sqrt(norm);
        white[i] = rest / row[i];
        squares += white[i] * white[i];
        logs += log(row[i]);
        /* Standard deviations below the rounding errors of the numbers subtracted count as zero. */
        off[i] = isnan(y[b * width + i]) ? norm : fabs(y[b * width + i]) + fabs(residual[i]) + norm;
        to->singular[b] |= row[i] <= EPS / LIMIT * off[i];
        off[i] *= EPS;
        for (long k = 0; k < i; k++) off[i] += fabs(noise[i * width + k]) * off[k];
        off[i] /= noise[i * width + i];
        lost += off[i];
    }
    precise &= lost <= LIMIT;
    double total = squares;
    for (long c = 0; c < size; c++) {
        const double *row = factor + (width + c) * columns;
        double moved = 0.0;
        for (long k = 0; k < width; k++) moved += row[k] * white[k];
        double after = to->mean[b * size + c] = prior[b * size + c] + moved;
        double variance = 0.0;
        for (long k = 0; k < size; k++) variance += row[width + k] * row[width + k];
        precise &= EPS * fabs(after) <= LIMIT * sqrt(variance);
        total += after * after + variance;
        memcpy(to->chol + (b * size + c) * size, row + width, sizeof(double) * (size_t)size);
    }
    to->nis[b] = squares;
    to->log_likelihood[b] = -0.5 * (squares + there * LOG_TWO_PI) - logs;
    return precise && !to->singular[b] && there == (double)width && total < INFINITY;
}

KERNEL long ahnn_condition(long batch, long size, long width, const double *joint, const double *y,
                           const double *prior, const double *chol_r, long r_step, double *residuals,
                           double *mean, double *chol, double *deviations, double *nis,
                           double *log_likelihood, unsigned char *singular) {
    const told to = {residuals, mean, chol, deviations, nis, log_likelihood, singular};
    long columns = width + size, sound = 1;
    double *work = malloc(sizeof(double) * (size_t)(2 * width));
    if (!work) return NO_MEMORY;
    for (long b = 0; b < batch; b++)
        sound &= condition(b, size, width, joint + b * columns * columns, y, prior, chol_r + b * r_step, &to, work);
    free(work);
    return sound ? SOUND : UNSOUND;
}

/* Compute the posterior if y (batch, width) measures the first components of the state. Opposite points then have
   opposite images, so that the rows of the prior's factor replace the images. */
KERNEL long ahnn_read(long batch, long size, long width, const double *y, const double *prior,
                      const double *chol, long chol_step, const double *chol_r, long r_step, double *residuals,
                      double *mean, double *after, double *deviations, double *nis, double *log_likelihood,
                      unsigned char *singular) {
    const told to = {residuals, mean, after, deviations, nis, log_likelihood, singular};
    long columns = width + size, rows = size + 2 * width, sound = 1;
    lanes *a = workspace((rows + 1 + columns) * columns + 2 * width), *scale = a + rows * columns;
    if (!a) return NO_MEMORY;
    double *joint = (double *)(scale + columns), *work = joint + LANES * columns * columns;
    for (long first = 0; first < batch; first += LANES) {
        block here = block_at(first, batch), own = block_at(0, here.count);
        lanes one = (lanes){} + 1.0;
        memset(a, 0, sizeof(lanes) * (size_t)(rows * columns));
        for (long c = 0; c < columns; c++)
            for (long i = 0; i < size; i++)
                a[c * rows + i] = load(chol, &here, chol_step, (c < width ? c : c - width) * size + i);
        for (long c = 0; c < width; c++) {
            lanes *column = a + c * rows, found = load(y, &here, width, c);
            bits there = found == found;
            for (long i = 0; i < size; i++) column[i] = pick(there, column[i], (lanes){});
            for (long i = 0; i < width; i++)
                column[size + i] = pick(there, load(chol_r, &here, r_step, c * width + i), (lanes){});
            column[size + width + c] = pick(there, (lanes){}, one);
            save(residuals, &here, width, c, found - load(prior, &here, size, c));
        }
        balance(a, scale, rows, columns);
        triangularise(a, rows, columns);
        save_factor(joint, &own, a, scale, rows, columns);
        for (long l = 0; l < here.count; l++)
            sound &= condition(first + l, size, width, joint + l * columns * columns, y, prior,
                               chol_r + (first + l) * r_step, &to, work);
    }
    free(a);
    return sound ? SOUND : UNSOUND;
}

/* Complete a step after the flow: the prediction, the posterior given the row y (unless y is null), and the sigma
   points of the next step. The step is sound if prediction and posterior are, no NIS exceeds the limit, and no
   residual exceeds half a period; otherwise the sigma points are not computed. */
static long whole_step(long batch, long size, long width, const double *points, const double *outer,
                const double *recentring, const double *radius, long weight_step, const double *chol_q, long q_step, const double *y,
                const double *chol_r, long r_step, double limit, const double *half, double *prior,
                double *prior_chol, double *residuals, double *mean, double *chol, double *deviations, double *nis,
                double *log_likelihood, unsigned char *singular, double *further) {
    long own = size * size;
    long told = ahnn_predict(batch, size, points, outer, recentring, weight_step, chol_q, q_step, prior,
                             prior_chol);
    if (told == SOUND && y) {
        told = ahnn_read(batch, size, width, y, prior, prior_chol, own, chol_r, r_step, residuals, mean, chol,
                         deviations, nis, log_likelihood, singular);
        for (long b = 0; b < batch && told == SOUND; b++) told = nis[b] <= limit ? SOUND : UNSOUND;
        for (long i = 0; i < batch * width && told == SOUND; i++)
            told = fabs(residuals[i]) <= half[i % width] ? SOUND : UNSOUND;
    }
    if (told != SOUND) return told;
    return ahnn_draw(batch, size, y ? mean : prior, y ? chol : prior_chol, own, radius, weight_step, further);
}

/* Write the states (count, size) reached from x after a step dt; return 0 on success. */
typedef long flow(const void *about, long count, const double *x, double dt, double *out);

/* Run several steps, each consisting of the flow and `whole_step`, from sigma points (batch, 2 size + 1, size) in
   `points`. Step k has the length dt[k] and the process noise chol_q + k q_next, and uses the next row of y if
   measured[k] is set. Results are stored step after step. The run stops at the first step that is not sound, and
   leaves its points before the flow in `points` and after it in `moved`; `done` is the number of sound steps. */
long ahnn_follow(long batch, long size, long width, long steps, flow *propagate, const void *about, const double *dt,
                 const unsigned char *measured, const double *outer, const double *recentring, const double *radius,
                 long weight_step, const double *chol_q, long q_step, long q_next, const double *y,
                 const double *chol_r, long r_step, double limit, const double *half, double *points, double *moved,
                 double *prior, double *prior_chol, double *residuals, double *mean, double *chol, double *deviations,
                 double *nis, double *log_likelihood, unsigned char *singular, long *done) {
    long vector = batch * size, matrix = vector * size, row = batch * width;
    for (*done = 0; *done < steps; ++*done) {
        long k = *done;
        if (propagate(about, batch * (2 * size + 1), points, dt[k], moved)) return NO_FLOW;
        long told = whole_step(batch, size, width, moved, outer, recentring, radius, weight_step, chol_q + k * q_next,
                               q_step, measured[k] ? y : NULL, chol_r, r_step, limit, half, prior + k * vector,
                               prior_chol + k * matrix, residuals + k * row, mean + k * vector, chol + k * matrix,
                               deviations + k * row, nis + k * batch, log_likelihood + k * batch,
                               singular + k * batch, points);
        if (told != SOUND) return told;
        if (measured[k]) y += row;
    }
    return SOUND;
}
