/* What a C compiler makes of a stage's kernels, cell after cell: transport, drift, moments, Gaussian and its mixture.

   The scheme of rvm_mpi's parts of those names (docs/method.md), with numbers given in place of what a stage works out
   for each cell: omega at the faces, the drift's rates, the Gaussian's parameters. A block is slabs of S nodes (xi_y,
   xi_z), xi_x slowest; nodes with xi_y < 0 and all of a slab are whole vectors. stage_bound.py compiles, times it. */
#include <math.h>
#include <string.h>
#ifdef __AVX512F__
enum { LANES = 8 };
#else
enum { LANES = 4 };
#endif
typedef double vec __attribute__((vector_size(LANES * 8), aligned(8)));
enum { Y, Z, Y_FACE, Z_FACE, VALID, Y_LEAST, Y_OPEN, Z_LEAST, Z_OPEN, MAX = 4096, GUARD = 64 };
__attribute__((simd("notinbranch"))) double exp(double);
typedef struct {
    long px, S, nz, below, row, nx, ny; /* nodes along x, of a slab, along z, with xi_y < 0; doubles a row; cells */
    const double *x, *x_face, *slab, *omega, *per, *rates, *theta, *centre;
    double dt, weight_old, weight_new, own, share;
} Case;
#define ROW(name) (c->slab + (name) * c->S)
typedef long long mask __attribute__((vector_size(LANES * 8)));
#define one ((vec){0} + 1)
static inline vec at(const double *p) { return *(const vec *)p; }
static inline void put(double *p, vec a) { *(vec *)p = a; }
static inline vec pick(mask c, vec a, vec b) { return (vec)((c & (mask)a) | (~c & (mask)b)); }
static double sum(vec a) { double s = 0; for (int l = 0; l < LANES; l++) s += a[l]; return s; }

/* one slab's fluxes through the upper faces, its nodes from n to end; m: sums 1, y, z, y^2 + z^2 of f and of h */
static inline void faces(const Case *c, long n, long end, double rate, double omega_y, const double *xb,
                         const double *xh, const double *xa, const double *yb, const double *yh, const double *ya,
                         double *west, double *south, double *change, double *m) {
    vec s[8] = {0};
    for (long i = n; i < end; i += LANES) {
        __builtin_prefetch(xa + i + 128), __builtin_prefetch(xb + i + 128);
        __builtin_prefetch(ya + i + 128), __builtin_prefetch(yb + i + 128);
        vec y = at(ROW(Y) + i), z = at(ROW(Z) + i), u = at(xh + i), v = at(yh + i), square = y * y + z * z;
        vec a = u - at(xb + i), b = at(xa + i) - u, d = v - at(yb + i), e = at(ya + i) - v, p = a * b, q = d * e;
        vec t = pick(p > 1e-180, a + b, one), w = pick(q > 1e-180, d + e, one), inverse = 1 / (t * w); /* one division */
        vec f = (u + pick(p > 1e-180, p, 0 * one) * w * inverse) * rate;
        vec h = (v + pick(q > 1e-180, q, 0 * one) * t * inverse) * (y * (omega_y * c->per[1]));
        put(change + i, (at(west + i) - f) + (at(south + i) - h)), put(west + i, f), put(south + i, h);
        s[0] += f, s[1] += f * y, s[2] += f * z, s[3] += f * square;
        s[4] += h, s[5] += h * y, s[6] += h * z, s[7] += h * square;
    }
    for (int q = 0; q < 8; q++) m[q] = sum(s[q]);
}

static void transport(const Case *c, const double *g, long ax, long ay, double *west, double *south, double *change,
                      double *moments) {
    memset(moments, 0, 10 * sizeof(double));
    for (long k = 0; k < c->px; k++) {
        const double *s = g + k * c->S, xk = c->x[k], o = c->omega[xk > 0 ? 0 : 1];
        const double *h = xk > 0 ? s : s + ax, *b = xk > 0 ? s - ax : s + 2 * ax, *a = xk > 0 ? s + ax : s;
        for (int up = 0; up < 2; up++) {
            double m[8], w = c->omega[up ? 2 : 3], rate = ax ? o * xk * c->per[0] : 0;
            long n = up ? c->below : 0, end = up ? c->S : c->below, j = k * c->S;
            faces(c, n, end, rate, ay ? w : 0, b, h, a, up ? s - ay : s + 2 * ay, up ? s : s + ay, up ? s + ay : s,
                  west + j, south + j, change + j, m);
            double add[] = {m[0], m[0] * o * xk, m[1] * o, m[2] * o, (m[3] + m[0] * xk * xk) * o * o,
                            m[4], m[4] * w * xk, m[5] * w, m[6] * w, (m[7] + m[4] * xk * xk) * w * w};
            for (int q = 0; q < 10; q++) moments[q] += add[q];
        }
    }
}

static void drift(const Case *c, const double *g, const double *old, double *result) {
    static double rows[7][MAX + 2 * GUARD] __attribute__((aligned(64)));
    double *bx = rows[0] + GUARD, *next = rows[1] + GUARD, *by = rows[2] + GUARD, *bz = rows[3] + GUARD;
    double *fx = rows[4] + GUARD, *fy = rows[5] + GUARD, *fz = rows[6] + GUARD;
    const double *r = c->rates, *y = ROW(Y), *yf = ROW(Y_FACE), *zf = ROW(Z_FACE);
    const double *yl = ROW(Y_LEAST), *zl = ROW(Z_LEAST), *yo = ROW(Y_OPEN), *zo = ROW(Z_OPEN);
    const double rise_y = r[3], fall_y = r[4], push_y = r[6] * r[9], push_z = r[7] * r[10], per_y = r[9], per_z = r[10];
    long S = c->S, nz = c->nz;
    memset(bx, 0, S * sizeof *bx), memset(fx, 0, S * sizeof *fx);
    for (long k = 0; k < c->px; k++) {
        const double *s = g + k * S, *o = old + k * S;
        double *res = result + k * S, xk = c->x[k], xf = c->x_face[k], in = k < c->px - 1;
        double along = r[0] + (xk > 0 ? r[1] : r[2]) * xk;
        double xl = k < c->px - 2 ? 1e-180 : INFINITY, sx1 = -in * r[8] * xf;
        double sx0 = in * (r[5] * r[8] - r[8] * (r[0] + (xf > 0 ? r[1] : r[2]) * xf) * xf);
#pragma omp simd
        for (long n = 0; n < S; n++) {
            double a = s[n + S] - s[n], b = s[n + 2 * S] - s[n + S], d = s[n] - s[n - nz], e = s[n + nz] - s[n];
            double t = s[n] - s[n - 1], u = s[n + 1] - s[n], p = a * b, q = d * e, w = t * u;
            double i = p > xl ? a + b : 1, j = q > yl[n] ? d + e : 1, l = w > zl[n] ? t + u : 1;
            double inverse = 1 / (i * j * l); /* one division for three */
            next[n] = (p > xl ? p : 0) * (j * l * inverse), by[n] = (q > yl[n] ? q : 0) * (i * l * inverse);
            bz[n] = (w > zl[n] ? w : 0) * (i * j * inverse);
        }
#pragma omp simd
        for (long n = 0; n < S; n++) {
            double turn = y[n] * (y[n] > 0 ? rise_y : fall_y), vx = turn * sx1 + sx0;
            double vy = yo[n] * push_y - yf[n] * (along + yf[n] * (yf[n] > 0 ? rise_y : fall_y)) * per_y;
            double vz = zo[n] * push_z - zf[n] * (along + turn) * per_z;
            double xl = s[n] + bx[n], xr = s[n + S] - next[n], yl = s[n] + by[n], yr = s[n + nz] - by[n + nz];
            double zl = s[n] + bz[n], zr = s[n + 1] - bz[n + 1], f = vx * (vx > 0 ? xl : xr);
            res[n] += fx[n] - f, fx[n] = f;
            fy[n] = vy * (vy > 0 ? yl : yr), fz[n] = vz * (vz > 0 ? zl : zr);
        }
#pragma omp simd
        for (long n = 0; n < S; n++) {
            double change = res[n] + (fy[n - nz] - fy[n]) + (fz[n - 1] - fz[n]);
            res[n] = (s[n] + change * c->dt) * c->weight_new + o[n] * c->weight_old;
        }
        double *swap = bx;
        bx = next, next = swap;
    }
}

/* node n of the plane: what a sum over x has left of a column, times 1, x, y, z, xx, xy, xz, yy, yz, zz, added to t */
static inline void add(const Case *c, long n, vec a0, vec a1, vec a2, vec *t) {
    vec y = at(ROW(Y) + n) - c->centre[1], z = at(ROW(Z) + n) - c->centre[2];
    t[0] += a0, t[1] += a1, t[2] += a0 * y, t[3] += a0 * z, t[4] += a2, t[5] += a1 * y, t[6] += a1 * z;
    t[7] += a0 * y * y, t[8] += a0 * y * z, t[9] += a0 * z * z;
}

static void moments(const Case *c, const double *block, double *sums) {
    vec t[10] = {0};
    for (long n = 0; n < c->S; n += LANES) {
        vec a0 = {0}, a1 = {0}, a2 = {0};
        for (long k = 0; k < c->px; k++) {
            vec f = at(block + k * c->S + n), s = f * (c->x[k] - c->centre[0]);
            a0 += f, a1 += s, a2 += s * (c->x[k] - c->centre[0]);
        }
        add(c, n, a0, a1, a2, t);
    }
    for (int q = 0; q < 10; q++) sums[q] = sum(t[q]);
}

static void gaussian_moments(const Case *c, double *block, double *sums) {
    static double e[3][MAX]; /* at the node nearest to the centre; ratios downwards and upwards from there */
    const double *th = c->theta, h = c->x[1] - c->x[0], curve = exp(2 * th[4] * h * h);
    long middle = lround((c->centre[0] - c->x[0]) / h);
    double x0 = c->x[middle] - c->centre[0];
    vec t[10] = {0};
    for (long n = 0; n < c->S; n += LANES) {
        vec y = at(ROW(Y) + n) - c->centre[1], z = at(ROW(Z) + n) - c->centre[2], tilt = th[1] + y * th[5] + z * th[6];
        vec base = th[0] + y * (th[2] + y * th[7]) + z * (th[3] + z * th[9] + y * th[8]);
        put(e[0] + n, base + (tilt + th[4] * x0) * x0);
        put(e[1] + n, -tilt * h - th[4] * h * (2 * x0 - h)), put(e[2] + n, tilt * h + th[4] * h * (2 * x0 + h));
    }
    for (int q = 0; q < 3; q++)
#pragma omp simd
        for (long n = 0; n < c->S; n++) e[q][n] = exp(e[q][n]);
    for (long n = 0; n < c->S; n += LANES) {
        vec a0 = {0}, a1 = {0}, a2 = {0};
        for (int up = 0; up < 2; up++) {
            vec f = at(e[0] + n) * at(ROW(VALID) + n), r = at(e[1 + up] + n);
            if (up) f *= r, r *= curve;
            for (long k = middle + up; k >= 0 && k < c->px; k += 2 * up - 1, f *= r, r *= curve) {
                double s = c->x[k] - c->centre[0];
                put(block + k * c->S + n, f);
                a0 += f, a1 += f * s, a2 += f * s * s;
            }
        }
        add(c, n, a0, a1, a2, t);
    }
    for (int q = 0; q < 10; q++) sums[q] = sum(t[q]);
}

/* g, out: at the first cell; west, result, gaussian: blocks; south: a row of them; report: 30 numbers a cell, then a ghost's */
void cells(const Case *c, const double *g, double *out, double *west, double *south, double *result, double *gaussian,
           double *report) {
    long block = c->px * c->S;
    for (long j = -1; j < c->ny; j++)
        for (long i = j < 0 ? 0 : -1; i < c->nx; i++) {
            long place = j * c->row + i * block;
            double *r = report + 30 * (j < 0 || i < 0 ? c->nx * c->ny : j * c->nx + i);
            transport(c, g + place, j < 0 ? 0 : block, i < 0 ? 0 : c->row, j < 0 ? gaussian : west,
                      i < 0 ? gaussian : south + i * block, result, r);
            if (i < 0 || j < 0) continue;
            drift(c, g + place, out + place, result);
            moments(c, result, r + 10);
            gaussian_moments(c, gaussian, r + 20);
#pragma omp simd
            for (long n = 0; n < block; n++) out[place + n] = c->own * result[n] + c->share * gaussian[n];
        }
}
