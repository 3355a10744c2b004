// What lies under the pointer or in a drawn box, and the line of a job that means it.

// Places of all points on the canvas, in pixels of the page, the third towards the viewer.
function projected(surface, shape, camera, box, height) {
  const { points } = surface, { turn, zoom, pan } = camera, out = new Float32Array(points.length);
  const half = Math.min(box[1], height) / 2, x0 = box[0] + box[1] / 2 + pan[0] * half, y0 = height / 2 - pan[1] * half;
  for (let i = 0; i < points.length; i += 3) {
    const x = points[i] + shape(i), y = points[i + 1] + shape(i + 1), z = points[i + 2] + shape(i + 2);
    out[i] = x0 + half * zoom * (turn[0] * x + turn[1] * y + turn[2] * z);
    out[i + 1] = y0 - half * zoom * (turn[3] * x + turn[4] * y + turn[5] * z);
    out[i + 2] = half * zoom * (turn[6] * x + turn[7] * y + turn[8] * z);
  }
  return out;
}

// The nearest triangle at a place, and the corner of it that is nearest there; null beside the part.
function hitAt(triangles, at, x, y) {
  let best = null, depth = -Infinity;
  for (let t = 0; t < triangles.length; t += 3) {
    const [a, b, c] = [3 * triangles[t], 3 * triangles[t + 1], 3 * triangles[t + 2]];
    const ux = at[b] - at[a], uy = at[b + 1] - at[a + 1], vx = at[c] - at[a], vy = at[c + 1] - at[a + 1];
    const det = ux * vy - uy * vx, px = x - at[a], py = y - at[a + 1];
    if (!det) continue;
    const s = (px * vy - py * vx) / det, r = (ux * py - uy * px) / det;
    if (s < 0 || r < 0 || s + r > 1) continue;
    const z = at[a + 2] + s * (at[b + 2] - at[a + 2]) + r * (at[c + 2] - at[a + 2]);
    if (z <= depth) continue;
    depth = z;
    const far = (i) => Math.hypot(at[i] - x, at[i + 1] - y);
    best = { triangle: t / 3, node: [a, b, c].reduce((i, j) => (far(j) < far(i) ? j : i)) / 3 };
  }
  return best;
}

// Triangles that are seen within a rectangle, and their points in it: the nearest triangle of each of some 160,000 places.
function seenWithin(triangles, at, [x0, y0, x1, y1]) {
  const n = 400, owner = new Int32Array(n * n).fill(-1), depth = new Float32Array(n * n).fill(-Infinity);
  const sx = n / Math.max(1e-6, x1 - x0), sy = n / Math.max(1e-6, y1 - y0);
  for (let t = 0; t < triangles.length; t += 3) {
    const [a, b, c] = [3 * triangles[t], 3 * triangles[t + 1], 3 * triangles[t + 2]];
    const X = [a, b, c].map((i) => (at[i] - x0) * sx), Y = [a, b, c].map((i) => (at[i + 1] - y0) * sy);
    const det = (X[1] - X[0]) * (Y[2] - Y[0]) - (Y[1] - Y[0]) * (X[2] - X[0]);
    const left = Math.max(0, Math.ceil(Math.min(...X) - 0.5)), right = Math.min(n - 1, Math.floor(Math.max(...X) - 0.5));
    const top = Math.max(0, Math.ceil(Math.min(...Y) - 0.5)), low = Math.min(n - 1, Math.floor(Math.max(...Y) - 0.5));
    if (!det) continue;
    for (let j = top; j <= low; j++) {
      for (let i = left; i <= right; i++) {
        const px = i + 0.5 - X[0], py = j + 0.5 - Y[0];
        const s = (px * (Y[2] - Y[0]) - py * (X[2] - X[0])) / det, r = ((X[1] - X[0]) * py - (Y[1] - Y[0]) * px) / det;
        if (s < 0 || r < 0 || s + r > 1) continue;
        const z = at[a + 2] + s * (at[b + 2] - at[a + 2]) + r * (at[c + 2] - at[a + 2]), k = j * n + i;
        if (z > depth[k]) { depth[k] = z; owner[k] = t; }
      }
    }
  }
  const seen = new Set(owner), nodes = new Set();
  seen.delete(-1);
  for (const t of seen) {
    for (const v of triangles.subarray(t, t + 3)) {
      const x = at[3 * v], y = at[3 * v + 1];
      if (x >= x0 && x <= x1 && y >= y0 && y <= y1) nodes.add(v);
    }
  }
  return { nodes: [...nodes], triangles: [...seen].map((t) => t / 3) };
}

// Numbers of a job: multiples of a power of ten that is a tenth of the margin, so that none is cut off inside of it.
function rounded(number, margin) {
  const step = 10 ** Math.floor(Math.log10(margin / 10));
  return String(+(Math.round(number / step) * step).toPrecision(12) + 0);
}

class Picker {
  // ``place`` gives the coordinates of a point in the numbers of the job.
  constructor(data, surface, groups, owner) {
    Object.assign(this, { data, surface, groups, owner });
    const { points, triangles } = surface, toJob = data.half / data.unit.length;
    this.place = (v) => [0, 1, 2].map((axis) => data.middle[axis] / data.unit.length + points[3 * v + axis] * toJob);
    let shortest = Infinity;
    for (let t = 0; t < triangles.length; t += 3) {
      const [a, b] = [3 * triangles[t], 3 * triangles[t + 1]];
      const length = Math.hypot(points[a] - points[b], points[a + 1] - points[b + 1], points[a + 2] - points[b + 2]);
      if (length > 0) shortest = Math.min(shortest, length);
    }
    // A twentieth of the shortest side, so that no neighbour is taken, and more than places are rounded to.
    this.margin = Math.max(shortest / 20, 4e-5) * toJob;
    this.used = [...new Set(triangles)];
  }

  write(numbers) { return numbers.map((x) => rounded(x, this.margin)).join(","); }

  within(low, high) {
    return this.used.filter((v) => this.place(v).every((x, axis) => x >= low[axis] && x <= high[axis]));
  }

  // Lines for one place: the face or hole it is on, sets with the node, a sphere, the node alone.
  ofClick({ triangle, node }) {
    const lines = [], feature = this.owner && this.owner[triangle] >= 0 && this.data.features[this.owner[triangle]];
    if (feature) lines.push({ line: feature.select, about: feature.about });
    const sets = this.groups.filter((group) => group.select && (group.members.has(node) || group.faces.has(triangle)));
    for (const group of sets.sort((a, b) => a.count - b.count).slice(0, 5)) {
      lines.push({ line: group.select, about: `${group.name}: ${group.count.toLocaleString("en")} ${group.kind === "elements" ? "elements" : "nodes"}` });
    }
    const corners = [...this.surface.triangles.subarray(3 * triangle, 3 * triangle + 3)], at = this.place(node);
    const radius = Math.max(...corners.map((v) => Math.hypot(...this.place(v).map((x, axis) => x - at[axis])))) + this.margin;
    lines.push({ line: `sphere:${this.write([...at, radius])}`, about: "a sphere around the node, to its neighbours" });
    lines.push({ line: `ids:${this.surface.labels[node]}`, about: "the node alone" });
    return lines;
  }

  // Lines for the seen nodes of a drawn box.
  ofBox({ nodes, triangles }) {
    if (!nodes.length) return [];
    const at = nodes.map(this.place), lines = [];
    const low = [0, 1, 2].map((axis) => Math.min(...at.map((p) => p[axis])) - this.margin);
    const high = [0, 1, 2].map((axis) => Math.max(...at.map((p) => p[axis])) + this.margin);
    const taken = this.within(low, high).length, more = taken - nodes.length;
    const own = `${nodes.length} seen node${nodes.length > 1 ? "s" : ""}`;
    lines.push({ line: `box:${this.write([...low, ...high])}`,
      about: more > 0 ? `${own}, and ${more} more of the skin that are behind or between` : `${own} of the skin` });
    if (nodes.length <= 60) {
      lines.push({ line: `ids:${nodes.map((v) => this.surface.labels[v]).sort((a, b) => a - b).join(",")}`, about: `${own} by their labels` });
    }
    const counts = new Map();
    for (const t of this.owner ? triangles : []) if (this.owner[t] >= 0) counts.set(this.owner[t], (counts.get(this.owner[t]) || 0) + 1);
    for (const [number, count] of [...counts].sort((a, b) => b[1] - a[1]).slice(0, 2)) {
      if (count > triangles.length / 2) lines.push({ line: this.data.features[number].select, about: this.data.features[number].about });
    }
    return lines;
  }
}
