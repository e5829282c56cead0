/* The models of the live figures: what the library `repro` computes, in the browser. No dependency, no page needed.
   Metres, radians, millitesla. A test compares each function with the library on thousands of random inputs. */
(function () {
"use strict";

// ---- Small dense algebra: vectors are arrays, matrices are arrays of rows ------------------------------------------

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const times = (R, x) => [dot(R[0], x), dot(R[1], x), dot(R[2], x)];
const plus = (a, b, scale = 1) => [a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]];
const zeros = (n, m) => Array.from({ length: n }, () => new Float64Array(m));
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

function product(A, B) {
  return A.map((row) => [0, 1, 2].map((k) => row[0] * B[0][k] + row[1] * B[1][k] + row[2] * B[2][k]));
}

/** Solve A x = b by elimination with pivots; A and b are overwritten. */
function solve(A, b) {
  const n = b.length;
  for (let c = 0; c < n; c++) {
    let pivot = c;
    for (let r = c + 1; r < n; r++) if (Math.abs(A[r][c]) > Math.abs(A[pivot][c])) pivot = r;
    [A[c], A[pivot], b[c], b[pivot]] = [A[pivot], A[c], b[pivot], b[c]];
    for (let r = c + 1; r < n; r++) {
      const factor = A[r][c] / A[c][c];
      if (factor === 0) continue;
      for (let k = c; k < n; k++) A[r][k] -= factor * A[c][k];
      b[r] -= factor * b[c];
    }
  }
  for (let c = n - 1; c >= 0; c--) {
    for (let k = c + 1; k < n; k++) b[c] -= A[c][k] * b[k];
    b[c] /= A[c][c];
  }
  return b;
}

/** Eigenvalues, smallest first, and unit eigenvectors of a symmetric matrix: rotations of Jacobi. */
function eigen(S) {
  const n = S.length, A = S.map((row) => Float64Array.from(row)), V = zeros(n, n);
  for (let k = 0; k < n; k++) V[k][k] = 1;
  for (let sweep = 0; sweep < 30; sweep++) {
    let off = 0;
    for (let p = 0; p < n; p++) for (let q = p + 1; q < n; q++) {
      if (A[p][q] === 0) continue;
      off += A[p][q] ** 2;
      const theta = (A[q][q] - A[p][p]) / (2 * A[p][q]);
      const t = (theta < 0 ? -1 : 1) / (Math.abs(theta) + Math.sqrt(theta * theta + 1));
      const c = 1 / Math.sqrt(t * t + 1), s = t * c;
      for (let k = 0; k < n; k++) [A[k][p], A[k][q]] = [c * A[k][p] - s * A[k][q], s * A[k][p] + c * A[k][q]];
      for (let k = 0; k < n; k++) [A[p][k], A[q][k]] = [c * A[p][k] - s * A[q][k], s * A[p][k] + c * A[q][k]];
      for (let k = 0; k < n; k++) [V[k][p], V[k][q]] = [c * V[k][p] - s * V[k][q], s * V[k][p] + c * V[k][q]];
    }
    if (off < 1e-60) break;
  }
  const order = [...Array(n).keys()].sort((a, b) => A[a][a] - A[b][b]);
  return { values: order.map((k) => A[k][k]), vectors: order.map((k) => V.map((row) => row[k])) };
}

// ---- Segments of constant curvature, eq. (15) of Baaij et al. 2023 -------------------------------------------------

const factorial = (n) => (n < 2 ? 1 : n * factorial(n - 1));
const SERIES = [1, 2, 3, 4].map((first) => Array.from({ length: 11 }, (_, k) => (k % 2 ? -1 : 1) / factorial(2 * k + first)));

/** Even functions of an angle by its square z, exact at zero: sin(t)/t, (1 - cos t)/t^2, (t - sin t)/t^3 and
    (1 - 2 (1 - cos t)/t^2)/t^2, of which the derivatives of the first two are made. */
function evenFunctions(z) {
  if (z < 1) {
    const f = SERIES.map((series) => series.reduceRight((total, c) => total * z + c, 0));
    return [f[0], f[1], f[2], 2 * f[3]];
  }
  const angle = Math.sqrt(z), half = Math.sin(angle / 2) / angle, sinc = Math.sin(angle) / angle, cosc = 2 * half * half;
  return [sinc, cosc, (1 - sinc) / z, (1 - 2 * cosc) / z];
}

/** Rotation R, position p and, for the three coordinates, how both move: angular velocities w, velocities v. */
function arc(q, length, radius, share) {
  const x = q[0] / radius, y = q[1] / radius, L = length + q[2], bend = x * x + y * y;
  const [sinc, cosc, third, fourth] = evenFunctions(share * share * bend);
  const s = share * sinc, c = share * share * cosc;
  const R = [[1 - x * x * c, -x * y * c, x * s], [-x * y * c, 1 - y * y * c, y * s], [-x * s, -y * s, 1 - bend * c]];
  const ds = share ** 3 * (third - cosc) / 2, dc = share ** 4 * (fourth - third) / 2; // by the squared bend
  const turn = share / radius, lean = share * cosc, twist = share * share * third, per = L / radius;
  const w = [
    [-turn * twist * x * y, turn * (1 - twist * y * y), -turn * lean * y],
    [-turn * (1 - twist * x * x), turn * twist * x * y, turn * lean * x],
    [0, 0, 0],
  ];
  const v = [
    [per * (c + 2 * x * x * dc), per * 2 * x * y * dc, per * 2 * x * ds],
    [per * 2 * x * y * dc, per * (c + 2 * y * y * dc), per * 2 * y * ds],
    [x * c, y * c, s],
  ];
  return { R, p: [L * x * c, L * y * c, L * s], w, v };
}

/** A robot of equal segments in series. A mount is {segment, axial, position, axis}, the last two in the frame of the
    cross-section at `axial`; magnets come first. */
function robot(segments, length, radius, magnets, sensors) {
  return { segments, length, radius, magnets, sensors, n: 3 * segments };
}

/** Frames of the bases of all segments and of the tip: {R, p}, and of each segment the twists of what lies beyond. */
function frames(body, q) {
  const bases = [{ R: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], p: [0, 0, 0] }], twists = [];
  for (let i = 0; i < body.segments; i++) {
    const placed = inWorld(bases[i], arc(q.slice(3 * i, 3 * i + 3), body.length, body.radius, 1));
    bases.push(placed);
    twists.push(placed.twists);
  }
  return { bases, twists };
}

/** An arc on its base in the world; a twist is (w, velocity of the point at the origin). */
function inWorld(base, local) {
  const p = plus(base.p, times(base.R, local.p));
  const twists = local.w.map((omega, j) => {
    const w = times(base.R, omega);
    return [...w, ...plus(times(base.R, local.v[j]), cross(w, p), -1)];
  });
  return { R: product(base.R, local.R), p, twists };
}

/** Axis and position of mounts in the world, and the twists of the segment that carries each. */
function placed(body, q, chain, mounts) {
  const known = new Map();
  return mounts.map((mount) => {
    const key = mount.segment + " " + mount.axial;
    if (!known.has(key)) {
      const own = arc(q.slice(3 * mount.segment, 3 * mount.segment + 3), body.length, body.radius, mount.axial / body.length);
      known.set(key, inWorld(chain.bases[mount.segment], own));
    }
    const at = known.get(key);
    return {
      segment: mount.segment, twists: at.twists,
      axis: times(at.R, mount.axis), position: plus(at.p, times(at.R, mount.position)),
    };
  });
}

/** Points along the backbone, `count` intervals for each segment. */
function backbone(body, q, count) {
  const { bases } = frames(body, q), points = [[0, 0, 0]];
  for (let i = 0; i < body.segments; i++) for (let k = 1; k <= count; k++) {
    const local = arc(q.slice(3 * i, 3 * i + 3), body.length, body.radius, k / count);
    points.push(plus(bases[i].p, times(bases[i].R, local.p)));
  }
  return points;
}

/** Position of the tip and its derivatives by the configuration, a row for each axis. */
function tip(body, q) {
  const chain = frames(body, q), p = chain.bases[body.segments].p, J = zeros(3, body.n);
  chain.twists.forEach((twists, i) => twists.forEach((t, j) => {
    const v = plus(t.slice(3), cross(t, p));
    for (let k = 0; k < 3; k++) J[k][3 * i + j] = v[k];
  }));
  return { p, J };
}

// ---- Ring magnets as series of multipoles --------------------------------------------------------------------------

/** Moments A_1, A_3, ... [mT m^(l+2)] of a ring: the charge of its faces, integrated in closed form. */
function ringMoments(outer, inner, height, polarisation, largest) {
  const P = [[1], [0, 1]], z = height / 2, moments = []; // Legendre polynomials, ascending powers
  const squared = [inner, outer].map((diameter) => diameter * diameter / 4 + z * z);
  for (let l = 2; l <= largest; l++) {
    P.push(Array.from({ length: l + 1 }, (_, k) => ((2 * l - 1) * (P[l - 1][k - 1] || 0) - (l - 1) * (P[l - 2][k] || 0)) / l));
  }
  for (let l = 1; l <= largest; l += 2) {
    let total = 0;
    for (let k = 1; k <= l; k += 2) {
      const power = (l - k) / 2 + 1; // of r^2
      total += P[l][k] * z ** k * (squared[1] ** power - squared[0] ** power) / (2 * power);
    }
    moments.push(polarisation * total);
  }
  return moments;
}

/** Factors f, g of the field B = f m + g p/|p| at the cosine c, and their derivatives by c and by distance. */
function multipole(moments, distance, c) {
  const inverse = 1 / distance, squared = inverse * inverse;
  let decay = squared * inverse, f = 0, g = 0, fc = 0, gc = 0, fd = 0, gd = 0;
  let p0 = 1, p1 = c, s0 = 0, s1 = 1, t0 = 0, t1 = 0; // P, P', P'' of orders l - 1 and l
  for (let k = 0; k < moments.length; k++) {
    const l = 2 * k + 1, weight = moments[k] * decay;
    const p2 = ((2 * l + 1) * c * p1 - l * p0) / (l + 1), s2 = s0 + (2 * l + 1) * p1, t2 = t0 + (2 * l + 1) * s1;
    f -= weight * s1; g += weight * s2;
    fc -= weight * t1; gc += weight * t2;
    fd += (l + 2) * weight * s1; gd -= (l + 2) * weight * s2;
    const p3 = ((2 * l + 3) * c * p2 - (l + 1) * p1) / (l + 2), s3 = s1 + (2 * l + 3) * p2, t3 = t1 + (2 * l + 3) * s2;
    p0 = p2; p1 = p3; s0 = s2; s1 = s3; t0 = t2; t1 = t3;
    decay *= squared;
  }
  return { f, g, fc, gc, fd: fd * inverse, gd: gd * inverse };
}

/** Flux density [mT] at a point, of magnets that are placed. */
function fieldAt(magnets, moments, [x, y, z]) {
  const B = [0, 0, 0];
  for (const { position, axis } of magnets) {
    const px = x - position[0], py = y - position[1], pz = z - position[2], d = Math.sqrt(px * px + py * py + pz * pz);
    const { f, g } = multipole(moments, d, (px * axis[0] + py * axis[1] + pz * axis[2]) / d), along = g / d;
    B[0] += f * axis[0] + along * px;
    B[1] += f * axis[1] + along * py;
    B[2] += f * axis[2] + along * pz;
  }
  return B;
}

/** Readings u and, if asked for, their derivatives J by the configuration: q => {u, J}.
    `gains` are those of the sensors, 1 where none are given. */
function magneticSensing(body, moments, gains) {
  return function (q, slopes = true) {
    const chain = frames(body, q), magnets = placed(body, q, chain, body.magnets);
    const sensors = placed(body, q, chain, body.sensors);
    const u = new Float64Array(sensors.length), J = slopes ? zeros(sensors.length, body.n) : null;
    const byM = [0, 0, 0], byP = [0, 0, 0], p = [0, 0, 0]; // used again and again
    sensors.forEach((sensor, s) => {
      const o = sensor.axis, gain = gains ? gains[s] : 1, torque = [0, 0, 0], force = [0, 0, 0];
      for (const magnet of magnets) {
        const m = magnet.axis;
        for (let k = 0; k < 3; k++) p[k] = sensor.position[k] - magnet.position[k];
        const d = Math.sqrt(dot(p, p)), alpha = dot(o, m), beta = dot(o, p) / d, c = dot(m, p) / d;
        const { f, g, fc, gc, fd, gd } = multipole(moments, d, c);
        u[s] += gain * (f * alpha + g * beta);
        if (!slopes) continue;
        const byC = fc * alpha + gc * beta, along = (fd * alpha + gd * beta - (g * beta + byC * c) / d) / d;
        for (let k = 0; k < 3; k++) {
          byM[k] = f * o[k] + byC / d * p[k];
          byP[k] = along * p[k] + (g * o[k] + byC * m[k]) / d;
          force[k] += byP[k];
        }
        // Turning everything changes no reading: the torques on sensor and magnet cancel.
        const turning = plus(cross(magnet.position, byP), cross(m, byM), -1);
        for (let k = 0; k < 3; k++) torque[k] += turning[k];
        pull(J[s], chain, magnet, turning, byP, -gain);
      }
      if (slopes) pull(J[s], chain, sensor, torque, force, gain);
    });
    return { u, J };
  };
}

/** Add to a row of derivatives what a wrench about the origin does on the twists that move a part. */
function pull(row, chain, part, torque, force, gain) {
  for (let i = 0; i <= part.segment; i++) {
    const twists = i < part.segment ? chain.twists[i] : part.twists;
    for (let j = 0; j < 3; j++) {
      const t = twists[j];
      row[3 * i + j] += gain * (torque[0] * t[0] + torque[1] * t[1] + torque[2] * t[2]
        + force[0] * t[3] + force[1] * t[4] + force[2] * t[5]);
    }
  }
}

// ---- Least squares and descent -------------------------------------------------------------------------------------

const EPS = 2 ** -52, TOLERANCE = 1e-12;

/** Levenberg-Marquardt within bounds, from q: {q, u, J, rmse, trail}. `use` says which readings count;
    the trail has configuration and mean squared error after every iteration. */
function levenbergMarquardt(sensing, q, u, use, low, high, iterations) {
  const n = q.length, used = use.reduce((total, one) => total + (one ? 1 : 0), 0);
  const residuals = (found) => u.map((x, s) => (use[s] ? x - found.u[s] : 0));
  const square = (r) => r.reduce((total, x) => total + x * x, 0);
  let best = sensing(q), r = residuals(best), error = square(r), damping = 1e-3, count = 0;
  q = Float64Array.from(q);
  const trail = [{ q, loss: error / used }];
  for (let small = false; count < iterations && !small; count++) {
    const g = new Float64Array(n), A = zeros(n, n);
    best.J.forEach((row, s) => {
      if (!use[s]) return;
      for (let c = 0; c < n; c++) {
        g[c] += row[c] * r[s];
        for (let k = 0; k < n; k++) A[c][k] += row[c] * row[k];
      }
    });
    const free = Array.from(q, (x, c) => !((x <= low[c] && g[c] < 0) || (x >= high[c] && g[c] > 0)));
    const floor = EPS * Math.max(...A.map((row, c) => row[c])) + 2 ** -1022;
    A.forEach((row, c) => {
      const scale = Math.max(row[c], floor);
      for (let k = 0; k < n; k++) if (!free[c] || !free[k]) row[k] = 0;
      row[c] += free[c] ? damping * scale + floor : 1;
      if (!free[c]) g[c] = 0;
    });
    const delta = solve(A, g), trial = q.map((x, c) => clamp(x + delta[c], low[c], high[c]));
    small = trial.every((x, c) => Math.abs(x - q[c]) <= TOLERANCE * (high[c] - low[c]));
    const found = sensing(trial), rTrial = residuals(found), errorTrial = square(rTrial);
    const better = errorTrial < error;
    if (better) [q, best, r, error] = [trial, found, rTrial, errorTrial];
    damping = clamp(better ? damping / 10 : damping * 10, 1e-12, 1e12);
    trail.push({ q, loss: error / used });
  }
  return { q, u: best.u, J: best.J, rmse: Math.sqrt(error / used), trail };
}

/** Information about the coordinates, each in its unit `scale` (by default such that the diagonal is one):
    {values, vectors, scale} of the scaled J^T J, in units of squared readings. */
function information(J, use, scale) {
  const n = J[0].length, rows = J.filter((_, s) => use[s]);
  const unit = scale || Array.from({ length: n }, (_, c) => 1 / (Math.hypot(...rows.map((row) => row[c])) || 1));
  const A = zeros(n, n);
  for (const row of rows) for (let c = 0; c < n; c++) for (let k = 0; k < n; k++) A[c][k] += row[c] * unit[c] * row[k] * unit[k];
  return { ...eigen(A), scale: unit };
}

/** Covariance noise^2 (J^T J)^-1; directions without information get the variance of rounding: large, finite. */
function covariance(J, use, noise) {
  const { values, vectors, scale } = information(J, use), n = scale.length, C = zeros(n, n);
  values.forEach((value, e) => {
    const weight = noise * noise / Math.max(value, EPS * n), v = vectors[e];
    for (let c = 0; c < n; c++) for (let k = 0; k < n; k++) C[c][k] += weight * v[c] * v[k] * scale[c] * scale[k];
  });
  return C;
}

/** Gradient descent with momentum, eqs (9)-(12): {q, momentum, loss, trail}; the best of `iterations`
    evaluations is the estimate. The trail has every iterate and its loss, until one is no number. */
function gradientDescent(sensing, q, momentum, u, use, steps, mu, iterations) {
  const used = use.reduce((total, one) => total + (one ? 1 : 0), 0), trail = [];
  let x = Float64Array.from(q), b = Float64Array.from(momentum), loss = Infinity, best = x;
  for (let k = 0; k < iterations; k++) {
    const last = k === iterations - 1, found = sensing(x, !last);
    let here = 0;
    found.u.forEach((value, s) => { if (use[s]) here += (value - u[s]) ** 2 / used; });
    if (!Number.isFinite(here)) break;
    if (here < loss) [loss, best] = [here, x];
    trail.push({ q: x, loss: here });
    if (last) break;
    b = b.map((old) => mu * old);
    found.J.forEach((row, s) => {
      if (use[s]) for (let c = 0; c < b.length; c++) b[c] += 2 / used * (found.u[s] - u[s]) * row[c];
    });
    x = x.map((old, c) => old - steps[c] * b[c]);
  }
  return { q: best, momentum: b, loss, trail };
}

// ---- A cube at the end of a bent arc, and a particle filter (Mitchell et al. 2021) ---------------------------------

/** Flux density [mT] at the sensor at the base of an arc of bend (x, y) [rad], a cube magnet at its end. */
function bendReading(x, y, length, edge, polarisation) {
  const z = x * x + y * y, half = evenFunctions(z / 4)[0], a = edge / 2, scale = polarisation / (4 * Math.PI);
  const s = half * Math.sqrt(1 - z / 4 * half * half), c = half * half / 2;
  // The sensor seen from the magnet, mirrored into the first octant, where nothing cancels.
  const at = [length * x * c, length * y * c, -length * s], mirror = at.map((p) => (p < 0 || Object.is(p, -0) ? -1 : 1));
  let alongX = 1, alongY = 1, angle = 0;
  const [x0, y0, z0] = at.map((p, k) => p * mirror[k]);
  for (let i = -1; i < 2; i += 2) for (let j = -1; j < 2; j += 2) for (let k = -1; k < 2; k += 2) {
    const xi = x0 - i * a, eta = y0 - j * a, zeta = z0 - k * a, r = Math.sqrt(xi * xi + eta * eta + zeta * zeta), odd = i * j * k;
    alongX *= odd > 0 ? eta + r : 1 / (eta + r);
    alongY *= odd > 0 ? xi + r : 1 / (xi + r);
    angle += odd * Math.atan2(xi * eta * Math.sign(zeta), Math.abs(zeta) * r);
  }
  const Bx = -scale * mirror[0] * mirror[2] * Math.log(alongX), By = -scale * mirror[1] * mirror[2] * Math.log(alongY);
  const Bz = scale * angle, along = x * Bx + y * By, push = s * Bz - c * along;
  return [Bx + x * push, By + y * push, Bz - s * along - c * z * Bz];
}

/** Weights of particles `cloud` = [[x, y], ...] by readings u, eqs (1) and (2) with the noise of a reading. */
function weigh(cloud, u, noise, sensing) {
  const logs = cloud.map((q) => sensing(q[0], q[1]).reduce((total, x, k) => total + (x - u[k]) ** 2, 0) / (-2 * noise ** 2));
  const largest = logs.reduce((a, b) => Math.max(a, b)), total = logs.reduce((sum, x) => sum + Math.exp(x - largest), 0);
  const floor = Math.log(2 ** -1022) / 2;
  return logs.map((x) => Math.exp(Math.max(x - largest - Math.log(total), floor)));
}

/** Mean by weight, and the paper's estimate from the best tenth, eqs (3) and (4). */
function cloudEstimates(cloud, w) {
  const order = w.map((_, k) => k).sort((a, b) => w[b] - w[a]).slice(0, Math.ceil(w.length / 10));
  const mean = [0, 1].map((c) => cloud.reduce((total, q, k) => total + w[k] * q[c], 0));
  let angle = 0, x = 0, y = 0;
  for (const k of order) {
    const size = Math.hypot(cloud[k][0], cloud[k][1]);
    angle += size / order.length;
    x += cloud[k][0] / Math.max(size, 1e-300);
    y += cloud[k][1] / Math.max(size, 1e-300);
  }
  const length = Math.max(Math.hypot(x, y), 1e-300);
  return { mean, bestTenth: [angle * x / length, angle * y / length], effective: 1 / w.reduce((sum, x) => sum + x * x, 0) };
}

/** Indices of particles drawn by weight at increasing shares of the sum of all weights. */
function resample(w, shares) {
  let total = 0, k = 0;
  const edges = w.map((x) => (total += x));
  return shares.map((share) => {
    while (k < w.length - 1 && edges[k] <= share * total) k++;
    return k;
  });
}

/** Particles after a step of motion within a disc. `normal(k)` gives the numbers of draw k, one pair per particle;
    noise that leads outside is drawn again, 50 times at most. */
function moveParticles(cloud, width, reach, normal) {
  const inside = (q) => q[0] * q[0] + q[1] * q[1] <= reach * reach;
  const after = (q, e) => [q[0] + width * e[0], q[1] + width * e[1]];
  let noise = normal(0), moved = cloud.map((q, k) => after(q, noise[k]));
  for (let draw = 1; draw <= 50 && !moved.every(inside); draw++) {
    noise = normal(draw);
    moved = moved.map((q, k) => (inside(q) ? q : after(cloud[k], noise[k])));
  }
  return moved.map((q, k) => (inside(q) ? q : cloud[k]));
}

window.REPRO = {
  algebra: { dot, cross, plus, clamp, solve, eigen, zeros },
  robot, frames, placed, backbone, tip, ringMoments, fieldAt, magneticSensing,
  levenbergMarquardt, gradientDescent, information, covariance,
  bendReading, weigh, cloudEstimates, resample, moveParticles,
  views: {},
};
})();
