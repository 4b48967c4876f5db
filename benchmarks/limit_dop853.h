/* DOP853 on momentum and quaternion, and a Newton step towards length one. See midlie_jax/integrators/runge_kutta.py.
   STAGE_n(k) in limit.h is the weighted sum of the changes k(0), k(1) ... of the earlier stages, STEP(k) that of all. */

INLINE top changes(const body *b, vec3 p, quat q) { /* h times the rates: those of midlie_jax/integrators/system.py, h last */
    top s = {p, q};
    REAL half = b->h / 2;
    real3 g = b->gaps, i = b->inverses;
    vec3 u = {half * i.x * p.x, half * i.y * p.y, half * i.z * p.z};
    pull(b, &s);
    s.p = (vec3){b->h * (b->per_unit * g.x * p.y * p.z + s.pull_x), b->h * (b->per_unit * g.y * p.z * p.x + s.pull_y),
                 b->h * (b->per_unit * g.z * p.x * p.y)};
    s.q = (quat){-q.x * u.x - q.y * u.y - q.z * u.z, q.w * u.x + q.y * u.z - q.z * u.y,
                 q.w * u.y + q.z * u.x - q.x * u.z, q.w * u.z + q.x * u.y - q.y * u.x};
    return s;
}

#define PX(n) change[n].p.x
#define PY(n) change[n].p.y
#define PZ(n) change[n].p.z
#define QW(n) change[n].q.w
#define QX(n) change[n].q.x
#define QY(n) change[n].q.y
#define QZ(n) change[n].q.z
#define MOMENTUM(sum) ((vec3){s->p.x + sum(PX), s->p.y + sum(PY), s->p.z + sum(PZ)})
#define ATTITUDE(sum) ((quat){s->q.w + sum(QW), s->q.x + sum(QX), s->q.y + sum(QY), s->q.z + sum(QZ)})
#define STAGE(n) change[n] = changes(b, MOMENTUM(STAGE_##n), ATTITUDE(STAGE_##n));

INLINE void step_DOP853(const body *b, top *s) {
    top change[12];
    change[0] = changes(b, s->p, s->q);
    STAGE(1) STAGE(2) STAGE(3) STAGE(4) STAGE(5) STAGE(6) STAGE(7) STAGE(8) STAGE(9) STAGE(10) STAGE(11)
    s->p = MOMENTUM(STEP), s->q = unit(ATTITUDE(STEP));
}
