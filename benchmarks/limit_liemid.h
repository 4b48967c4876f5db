/* LIEMID: g (v + u x v) = y - u x y, v = 4 I u, g = atan|u|/|u|, y = h Pi. See midlie_jax/integrators/flights/lie_midpoint.py. */

typedef struct { vec3 a, b, c; vec factor; } inverse; /* rows of the adjugate, one over the determinant */

INLINE inverse invert(const vec3 *columns) {
    vec3 a = columns[0], b = columns[1], c = columns[2];
    inverse m = {cross(b, c), cross(c, a), cross(a, b), a.x};
    m.factor = rough_reciprocal(dot(a, m.a)); /* positive for the turns of a step */
    return m;
}
INLINE vec3 apply(inverse m, vec3 v) {
    return (vec3){m.factor * dot(m.a, v), m.factor * dot(m.b, v), m.factor * dot(m.c, v)};
}

INLINE vec3 residual(real3 four, vec3 y, vec3 u, int exact) {
    vec x = dot(u, u), g = exact ? POLYNOMIAL(ARCTANGENT, x) : POLYNOMIAL(ROUGH_ARCTANGENT, x);
    vec3 v = scale(g, times(four, u));
    return add(subtract(v, y), cross(u, add(v, y)));
}
INLINE void plain(vec3 k, vec3 y, vec3 u, vec3 *c) { /* columns of K + [u] K - [K u] - [y] */
    vec3 a = add(product(k, u), y);
    c[0] = (vec3){k.x, k.x * u.z - a.z, a.y - k.x * u.y};
    c[1] = (vec3){a.z - k.y * u.z, k.y, k.y * u.x - a.x};
    c[2] = (vec3){k.z * u.y - a.y, a.x - k.z * u.x, k.z};
}
INLINE inverse jacobian(real3 four, vec3 y, vec3 u) {
    vec x = dot(u, u), g = POLYNOMIAL(ROUGH_ARCTANGENT, x), slope = 2 * POLYNOMIAL(ROUGH_SLOPE, x);
    vec3 v = times(four, u), along = scale(slope, add(v, cross(u, v))), c[3];
    plain(times(four, (vec3){g, g, g}), y, u, c);
    c[0] = axpy(u.x, along, c[0]), c[1] = axpy(u.y, along, c[1]), c[2] = axpy(u.z, along, c[2]);
    return invert(c);
}
INLINE vec improve(inverse m, real3 four, vec3 y, vec3 *u, int exact) { /* returns |residual|^2 before */
    vec3 r = residual(four, y, *u, exact);
    *u = subtract(*u, apply(m, r));
    return dot(r, r);
}

INLINE void fly_liemid(const body *b, REAL h, top *s, int early) {
    const real3 four = {4 * b->relative.x, 4 * b->relative.y, 4 * b->relative.z};
    const REAL limit = 8 * EPSILON;
    vec none = 0 * s->p.x, one = none + 1;
    vec3 y = stretch(h * b->per_unit, s->p), zero = {none, none, none}, k = times(four, (vec3){one, one, one}), c[3];
    plain(k, stretch(2, y), zero, c);
    vec3 u = apply(invert(c), y);
    plain(k, y, zero, c);
    inverse m = invert(c);
    for (int i = 0; i < (early ? 1 : FIRST); i++) improve(m, four, y, &u, 0);
    if (early)
        for (int pair = 0; pair < 6; pair++) {
            m = jacobian(four, y, u);
            vec before = improve(m, four, y, &u, 1), between = improve(m, four, y, &u, 1);
            if (!any_lane(between * between > limit * limit * before * dot(y, y))) break;
        }
    else
        for (int round = 0; round < COUNT(MORE); round++) {
            m = jacobian(four, y, u);
            for (int i = 0; i < MORE[round]; i++) improve(m, four, y, &u, round == COUNT(MORE) - 1);
        }
    vec x = dot(u, u), share = reciprocal(1 + x);
    turn(s, (quat){(1 - x) * share, 2 * share * u.x, 2 * share * u.y, 2 * share * u.z});
}
INLINE void fly_every_step(const body *b, REAL h, top *s) { fly_liemid(b, h, s, 0); }
INLINE void fly_until_settled(const body *b, REAL h, top *s) { fly_liemid(b, h, s, 1); }

/* LIEMID takes the same Newton steps as the package, whatever the turn. LIEMID_EARLY stops when its own lanes have
   settled, which no program can that runs one loop over a batch without a branch. */
INLINE void step_LIEMID(const body *b, top *s) { verlet(b, s, 2, fly_every_step); }
INLINE void step_LIEMID_EARLY(const body *b, top *s) { verlet(b, s, 2, fly_until_settled); }
