/* JACOBI: the free motion in closed form, for any moments. See midlie_jax/integrators/flights/jacobi.py, whose letters these are.
   The package's choice of a series for a body nearly at rest is left out: these tops spin. */

typedef struct { vec re, im; } complex_number; /* im is in units of |y| */

INLINE complex_number complex_product(complex_number a, complex_number b, vec total) {
    return (complex_number){a.re * b.re - total * a.im * b.im, a.re * b.im + a.im * b.re};
}

INLINE complex_number half_phase(REAL rate, vec total) {
    vec square = rate * rate / 4 * total, cosine = POLYNOMIAL(COSINE, square), sine = POLYNOMIAL(SINE, square);
    return (complex_number){1 - 2 * square * sine * sine, rate * cosine * sine};
}

INLINE vec3 across(real3 gaps, vec3 y, vec3 differences, vec3 e, vec s) { /* n x y */
    vec3 sums = {e.y + e.z, e.z + e.x, e.x + e.y}, d = differences, pull = times(gaps, e), square = product(y, y);
    vec3 others = {sums.y * sums.z, sums.z * sums.x, sums.x * sums.y};
    vec share = s * s * reciprocal(sums.x * others.x);
    vec3 change = product(scale(share, others), (vec3){d.z - d.y, d.x - d.z, d.y - d.x});
    vec3 first = product((vec3){y.y * y.z, y.z * y.x, y.x * y.y}, product(e, change));
    vec3 turn = {pull.y * square.z - pull.z * square.y, pull.z * square.x - pull.x * square.z,
                 pull.x * square.y - pull.y * square.x};
    return add(first, scale(s, product(y, turn)));
}

INLINE void fly_jacobi(const body *b, REAL h, top *state) {
    const real3 a = b->gaps, m = b->middle;
    const real3 k = {a.y * m.z - a.z * m.y, a.z * m.x - a.x * m.z, a.x * m.y - a.y * m.x};
    const REAL a_jk = -(k.x * k.y + k.y * k.z + k.z * k.x);
    vec3 y = stretch(h * b->per_unit, state->p), squares = product(y, y);
    vec total = squares.x + squares.y + squares.z, K = weigh(k, squares), shared = a_jk * total;

    vec3 differences = {shared * m.x - K * k.x, shared * m.y - K * k.y, shared * m.z - K * k.z};
    vec wp = (differences.x + differences.y + differences.z) * (REAL)(1. / 3);
    vec3 roots = {wp - differences.x, wp - differences.y, wp - differences.z};
    vec g2 = 2 * dot(roots, roots), g3 = 4 * roots.x * roots.y * roots.z;
    vec s = SIGMA(wp, g2, g3), odd = SIGMA_ODD(wp, g2, g3), s2 = s * s;

    vec v = SIGMA_SQUARED_WP(wp, g2, g3) - wp * s2;
    vec3 e = {root(v + differences.x * s2), root(v + differences.y * s2), root(v + differences.z * s2)};
    vec d = v + a_jk * s2 * (total - weigh(m, squares));
    vec3 products = {y.y * y.z * e.x, y.z * y.x * e.y, y.x * y.y * e.z};
    vec3 n = add(product(y, (vec3){e.y * e.z, e.z * e.x, e.x * e.y}), scale(s, times(a, products)));

    vec per_total = reciprocal(total);
    vec3 along = scale(per_total, product(y, n));
    vec M = d + along.x + along.y + along.z, imaginary = -2 * a_jk * K * odd;
    complex_number F = {root(v - total * imaginary * imaginary), imaginary};
    complex_number Z = {d * (e.x + e.y + e.z) + dot(along, e) - M * weigh(m, e), s * (per_total * K * d + weigh(k, along))};
    complex_number whole = complex_product(F, Z, total);
    REAL rate = m.x * b->spins.x + m.y * b->spins.y + m.z * b->spins.z;
    complex_number half = complex_product((complex_number){v * M + whole.re, whole.im}, half_phase(rate, total), total);

    vec3 x = add(scale(half.re * per_total, across(a, y, differences, e, s)), scale(half.im, add(scale(d, y), n)));
    vec w = half.re * M, factor = inverse_root(w * w + dot(x, x));
    turn(state, (quat){factor * w, factor * x.x, factor * x.y, factor * x.z});
}
INLINE void step_JACOBI(const body *b, top *s) { verlet(b, s, 1, fly_jacobi); }
