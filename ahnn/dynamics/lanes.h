/* Vectors of double, or of float if SINGLE is defined, and activations of all lanes of a vector at once. */

#define INLINE static inline __attribute__((always_inline))
#if defined(__AVX512F__)
#define BYTES 64
#elif defined(__AVX2__)
#define BYTES 32
#else
#define BYTES 16
#endif

#ifdef SINGLE
typedef float real;
typedef int integer;
#else
typedef double real;
typedef long long integer;
#endif
#define LANES ((long)(BYTES / sizeof(real)))

typedef real lanes __attribute__((vector_size(BYTES), may_alias));
typedef integer bits __attribute__((vector_size(BYTES), may_alias));

/* A tail 1 - Phi(t) of the normal distribution is exp(-t^2 / 2) P(q) / (t + SHIFT), with q = (t - SHIFT) /
   (t + SHIFT) (Shepherd & Laframboise 1981, Math. Comp. 36, 249). P is a Chebyshev series, evaluated in powers of
   q; it is truncated at 3e-17 of its largest term in double, and at a relative error of 1.3e-8 in float. Beyond
   FAR the result would be denormal, which is slow. */
#ifdef SINGLE
enum { EXP_TERMS = 8, TAIL_TERMS = 10, MANTISSA = 23 };
#define ROUND 12582912.0f /* 1.5 2^23 */
#define LEAST -87.0f
#define LOG2_HIGH 0.693359375f
#define LOG2_LOW -2.12194440e-4f
#define ONE 0x3f800000
#define SHIFT 4.0f
#define FAR 12.9f
static const real INVERSE[] = {1.0f / 5040, 1.0f / 720, 1.0f / 120, 1.0f / 24, 1.0f / 6, 0.5f, 1.0f, 1.0f};
static const real TAIL[] = {
    -1.120079126e-04f, 2.205256404e-04f, 1.582084987e-03f, -3.533103224e-03f, -7.535270617e-03f,
    6.040710586e-02f, -1.865217865e-01f, 3.871367104e-01f, -6.078966514e-01f, 7.552851377e-01f};
#else
enum { EXP_TERMS = 14, TAIL_TERMS = 23, MANTISSA = 52 };
#define ROUND 6755399441055744.0 /* 1.5 2^52 */
#define LEAST -708.0
#define LOG2_HIGH 6.93147180369123816490e-01
#define LOG2_LOW 1.90821492927058770002e-10
#define ONE 0x3ff0000000000000LL
#define SHIFT 4.5
#define FAR 37.0
static const real INVERSE[] = {1.0 / 6227020800, 1.0 / 479001600, 1.0 / 39916800, 1.0 / 3628800, 1.0 / 362880,
                               1.0 / 40320,      1.0 / 5040,      1.0 / 720,      1.0 / 120,     1.0 / 24,
                               1.0 / 6,          0.5,             1.0,            1.0};
static const real TAIL[] = {
    1.0440252036819998e-09, 2.662280765855698e-10,  -1.1251292724707997e-08, -6.170870319722238e-09,
    7.060212865222912e-08,  6.605207817943098e-08,  -3.7926071995466557e-07, -5.037449540432435e-07,
    2.1426759805083802e-06, 3.192063301118266e-06,  -1.423571236638514e-05,  -1.59337294151542e-05,
    0.00011204260719214357, 6.381295655218961e-06,  -0.0009177464773392233,  0.0017488305479398012,
    0.004223613376799493,   -0.033871326175605156,  0.11138259657043223,     -0.2531417999510249,
    0.4464525170556733,     -0.6402577602526165,    0.7632305289702032};
#endif

enum { GELU, TANH, SILU };

/* The value of an activation sigma at z, with sigma' and sigma''. */
typedef struct {
    lanes value, slope, bend;
} point;

INLINE lanes pick(bits where, lanes yes, lanes no) {
    return (lanes)((where & (bits)yes) | (~where & (bits)no));
}

INLINE lanes polynomial(const real *powers, long terms, lanes x) {
    lanes sum = (lanes){} + powers[0];
    for (long k = 1; k < terms; k++) sum = sum * x + powers[k];
    return sum;
}

/* exp(x) for x <= 0: the nearest multiple of log 2 is subtracted (log 2 in two parts, Cody & Waite 1980), and
   the remainder enters a Taylor series. Below LEAST the result is exp(LEAST) instead of a denormal number. */
INLINE lanes exponential(lanes x) {
    const lanes least = (lanes){} + (real)LEAST, round = (lanes){} + (real)ROUND;
    x = pick(x < least, least, x);
    lanes shifted = x * (real)1.4426950408889634 + round, whole = shifted - round;
    lanes r = x - whole * (real)LOG2_HIGH;
    r = r - whole * (real)LOG2_LOW;
    bits power = ((bits)shifted << MANTISSA) + ((bits){} + ONE);
    return polynomial(INVERSE, EXP_TERMS, r) * (lanes)power;
}

/* z Phi(z), with slope Phi + z phi and bend phi (2 - z^2). */
INLINE point gelu(lanes z) {
    const lanes zero = {}, far = (lanes){} + (real)FAR;
    lanes t = pick(z < zero, -z, z);
    t = pick(t > far, far, t);
    lanes inverse = (real)1.0 / (t + (real)SHIFT), q = (t - (real)SHIFT) * inverse;
    lanes e = exponential((real)-0.5 * t * t), above = e * polynomial(TAIL, TAIL_TERMS, q) * inverse;
    lanes cumulative = pick(z < zero, above, (real)1.0 - above), density = (real)0.3989422804014327 * e;
    return (point){z * cumulative, cumulative + z * density, density * ((real)2.0 - t * t)};
}

/* In tanh_ and silu, exponentials of negative arguments keep the precision of small values at large |z|. */
INLINE point tanh_(lanes z) {
    const lanes zero = {};
    lanes e = exponential(pick(z < zero, (real)2.0 * z, (real)-2.0 * z));
    lanes inverse = (real)1.0 / ((real)1.0 + e);
    lanes size = ((real)1.0 - e) * inverse, value = pick(z < zero, -size, size);
    lanes slope = (real)4.0 * e * inverse * inverse;
    return (point){value, slope, (real)-2.0 * value * slope};
}

INLINE point silu(lanes z) {
    const lanes zero = {};
    lanes e = exponential(pick(z < zero, z, -z));
    lanes larger = (real)1.0 / ((real)1.0 + e), smaller = e * larger;
    lanes logistic = pick(z < zero, smaller, larger), other = pick(z < zero, larger, smaller);
    lanes value = z * logistic, steep = larger * smaller;
    return (point){value, logistic + value * other, steep * ((real)2.0 + z * (other - logistic))};
}

INLINE point activated(long activation, lanes z) {
    switch (activation) {
    case GELU: return gelu(z);
    case TANH: return tanh_(z);
    default: return silu(z);
    }
}
