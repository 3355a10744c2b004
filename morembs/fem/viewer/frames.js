// Frames of interfaces, which move with the nodes beside them.

// The turn (9 numbers, by rows) that takes the first points nearest to the second ones, both about their means: the
// quaternion of Horn (1987), by powers of his matrix from no turn at all, which lines and single points stay near.
function bestTurn(before, after) {
  const S = [0, 1, 2].map((i) => [0, 1, 2].map((j) => before.reduce((sum, p, n) => sum + p[i] * after[n][j], 0)));
  const lengths = before.reduce((sum, p, n) => sum + Math.hypot(...p) * Math.hypot(...after[n]), 0);
  const [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = S;
  const N = [[xx + yy + zz, yz - zy, zx - xz, xy - yx], [yz - zy, xx - yy - zz, xy + yx, zx + xz],
    [zx - xz, xy + yx, yy - xx - zz, yz + zy], [xy - yx, zx + xz, yz + zy, zz - xx - yy]];
  let q = [1, 0, 0, 0];
  for (let turn = 0; lengths && turn < 60; turn++) {
    const next = N.map((row, i) => row.reduce((sum, value, j) => sum + value * q[j], 0) + lengths * q[i]), size = Math.hypot(...next);
    if (!size) break;
    q = next.map((value) => value / size);
  }
  const [w, x, y, z] = q;
  return [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)];
}

const times = (turn, p) => [0, 1, 2].map((i) => turn[3 * i] * p[0] + turn[3 * i + 1] * p[1] + turn[3 * i + 2] * p[2]);

Object.assign(Viewer.prototype, {
  // Displacements of the points of a pane now, as numbers of its surface.
  shapeOf(pane) {
    const { numbers, scales, blend, amp } = this.moved(pane);
    const [now, next] = pane.motion < 0 ? [] : numbers.map((number) => this.fields[pane.motion].shapes[number]);
    return (k) => (now && k < now.length ? amp * (now[k] * scales[0] * (1 - blend) + next[k] * scales[1] * blend) : 0);
  },

  // Origin and axes of a frame in a pane, in the numbers of its surface.
  frameIn(pane, { at, axes, nodes }) {
    const { data } = this, surface = this.surfaceOf(pane), rows = nodes[this.surfaces.indexOf(surface)];
    const origin = at.map((value, k) => (value - data.middle[k]) / data.half);
    if (pane.motion < 0 || !rows?.length) return { origin, axes };
    const shape = this.shapeOf(pane), mean = (points) => [0, 1, 2].map((k) => points.reduce((sum, p) => sum + p[k], 0) / points.length);
    const before = rows.map((v) => [0, 1, 2].map((k) => surface.points[3 * v + k]));
    const after = rows.map((v, n) => before[n].map((value, k) => value + shape(3 * v + k)));
    const [from, to] = [mean(before), mean(after)], about = (points, middle) => points.map((p) => p.map((value, k) => value - middle[k]));
    const turn = bestTurn(about(before, from), about(after, to));
    return { origin: times(turn, origin.map((value, k) => value - from[k])).map((value, k) => to[k] + value), axes: axes.map((axis) => times(turn, axis)) };
  },
});
