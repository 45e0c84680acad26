/* Format numbers as the shortest decimals that read back as the same float64, in Python's notation.

   x 10^(16 - e) is computed in extended precision, with a relative error of 1e-19, and rounded to the smallest
   of 15, 16 or 17 digits that is within half a unit in the last place of x. */

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

enum { WIDEST = 32, EXACT = 27 };

static const long double TENS[EXACT + 1] = {1e0L,  1e1L,  1e2L,  1e3L,  1e4L,  1e5L,  1e6L,  1e7L,  1e8L,  1e9L,
                                            1e10L, 1e11L, 1e12L, 1e13L, 1e14L, 1e15L, 1e16L, 1e17L, 1e18L, 1e19L,
                                            1e20L, 1e21L, 1e22L, 1e23L, 1e24L, 1e25L, 1e26L, 1e27L};

/* Return x 10^power, for |power| up to 2 EXACT. */
static long double scaled(long double x, int power) {
    int size = power < 0 ? -power : power, rest = size > EXACT ? size - EXACT : 0;
    long double first = TENS[size - rest], second = TENS[rest];
    return power < 0 ? x / first / second : x * first * second;
}

/* Write the digits of x > 0 without trailing zeros, and the exponent of the first digit; return their number. */
static int digits_of(double x, char *digits, int *exponent) {
    int binary, power = (int)floor(log10(x)), count = 17;
    double mantissa = frexp(x, &binary);
    long double y = scaled(x, 16 - power);
    if (y >= 1e17L) y = scaled(x, 16 - ++power);
    if (y < 1e16L) y = scaled(x, 16 - --power);
    /* Half a unit in the last place; just below a power of two, half of this value. */
    long double half = scaled(ldexpl(mantissa == 0.5 ? 0.25L : 0.5L, binary - DBL_MANT_DIG), 16 - power);
    uint64_t whole = (uint64_t)(y + 0.5L), shorter;
    for (uint64_t unit = 100; unit > 1; unit /= 10) {
        shorter = (uint64_t)(y / unit + 0.5L) * unit;
        if (fabsl((long double)shorter - y) < 0.999L * half) {
            whole = shorter;
            break;
        }
    }
    if (whole >= 100000000000000000u) {
        whole /= 10;
        power++;
    }
    for (int i = count - 1; i >= 0; i--, whole /= 10) digits[i] = (char)('0' + whole % 10);
    while (count > 1 && digits[count - 1] == '0') count--;
    *exponent = power;
    return count;
}

static char *put(char *to, const char *from, int count) {
    memcpy(to, from, (size_t)count);
    return to + count;
}

static char *zeros(char *to, int count) {
    memset(to, '0', (size_t)count);
    return to + count;
}

/* Write one number; NaN is written as an empty cell. */
static char *number(char *to, double x) {
    char digits[WIDEST];
    int power, count;
    if (isnan(x)) return to;
    if (signbit(x)) *to++ = '-';
    x = fabs(x);
    if (x == 0.0) return put(to, "0.0", 3);
    if (isinf(x)) return put(to, "inf", 3);
    if (x < 1e-36 || x > 1e40) return to + snprintf(to, WIDEST, "%.17g", x);
    count = digits_of(x, digits, &power);
    if (power < -4 || power >= 16) {
        *to++ = digits[0];
        if (count > 1) {
            *to++ = '.';
            to = put(to, digits + 1, count - 1);
        }
        return to + snprintf(to, WIDEST, "e%c%02d", power < 0 ? '-' : '+', power < 0 ? -power : power);
    }
    if (power < 0) {
        to = zeros(put(to, "0.", 2), -power - 1);
        return put(to, digits, count);
    }
    if (count <= power + 1) {
        to = zeros(put(to, digits, count), power + 1 - count);
        return put(to, ".0", 2);
    }
    to = put(to, digits, power + 1);
    *to++ = '.';
    return put(to, digits + power + 1, count - power - 1);
}

/* Write numbers (rows, columns), separated by commas, with a line feed after each row; return the bytes written. */
long ahnn_decimals(long rows, long columns, const double *values, char *text) {
    char *to = text;
    for (long i = 0; i < rows; i++)
        for (long k = 0; k < columns; k++) {
            to = number(to, values[i * columns + k]);
            *to++ = k + 1 < columns ? ',' : '\n';
        }
    return to - text;
}
