// Numbers of a page, as packing.py writes them, back into arrays.

async function inflate(bytes) {
  if (!globalThis.DecompressionStream) return inflateHere(bytes);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// RFC 1951, for browsers that cannot; the header of gzip has ten bytes, as there is no name in it.
function inflateHere(data) {
  const size = new DataView(data.buffer, data.byteOffset + data.length - 4).getUint32(0, true);
  const out = new Uint8Array(size);
  let at = 10, held = 0, bits = 0, end = 0;
  const take = (count) => {
    while (held < count) { bits |= data[at++] << held; held += 8; }
    const value = bits & ((1 << count) - 1);
    bits >>>= count; held -= count;
    return value;
  };
  const tree = (lengths) => {
    const count = new Uint16Array(16), first = new Uint16Array(17), symbols = new Uint16Array(lengths.length);
    for (const length of lengths) if (length) count[length]++;
    for (let length = 1; length < 16; length++) first[length + 1] = first[length] + count[length];
    lengths.forEach((length, symbol) => { if (length) symbols[first[length]++] = symbol; });
    return { count, symbols };
  };
  const symbol = ({ count, symbols }) => {
    for (let length = 1, code = 0, first = 0, index = 0; length < 16; length++) {
      code |= take(1);
      if (code - first < count[length]) return symbols[index + code - first];
      index += count[length]; first = (first + count[length]) << 1; code <<= 1;
    }
    throw new Error("the data of this page are damaged");
  };
  const trees = () => {
    const counts = [take(5) + 257, take(5) + 1, take(4) + 4], lengths = new Array(19).fill(0), all = [];
    const order = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];
    for (let i = 0; i < counts[2]; i++) lengths[order[i]] = take(3);
    const codes = tree(lengths);
    while (all.length < counts[0] + counts[1]) {
      const next = symbol(codes);
      const [value, times] = next < 16 ? [next, 1] : next === 16 ? [all[all.length - 1], 3 + take(2)]
        : [0, next === 17 ? 3 + take(3) : 11 + take(7)];
      for (let i = 0; i < times; i++) all.push(value);
    }
    return [tree(all.slice(0, counts[0])), tree(all.slice(counts[0]))];
  };
  const fixed = () => [tree(Array.from({ length: 288 }, (_, i) => (i < 144 ? 8 : i < 256 ? 9 : i < 280 ? 7 : 8))),
    tree(new Array(30).fill(5))];
  for (let last = 0; !last;) {
    last = take(1);
    const kind = take(2);
    if (kind === 0) {
      held = bits = 0;
      const length = data[at] | (data[at + 1] << 8);
      out.set(data.subarray(at + 4, at + 4 + length), end);
      at += 4 + length; end += length;
      continue;
    }
    const [literals, distances] = kind === 1 ? fixed() : trees();
    for (let next; (next = symbol(literals)) !== 256;) {
      if (next < 256) { out[end++] = next; continue; }
      const n = next - 257, more = n < 8 || n === 28 ? 0 : (n >> 2) - 1;
      const length = (n === 28 ? 258 : n < 8 ? n + 3 : ((4 + (n & 3)) << more) + 3) + take(more);
      const d = symbol(distances), extra = d < 4 ? 0 : (d >> 1) - 1;
      const back = (d < 4 ? d + 1 : ((2 + (d & 1)) << extra) + 1) + take(extra);
      for (let i = 0; i < length; i++, end++) out[end] = out[end - back];
    }
  }
  return out;
}

// Differences row by row, as numbers; 32-bit integers need no more.
async function unpackRest({ rows, columns, bytes, data }) {
  const raw = await inflate(Uint8Array.from(atob(data), (c) => c.charCodeAt(0)));
  const out = new Float64Array(rows * columns);
  for (let column = 0; column < columns; column++) {
    for (let row = 0; row < rows; row++) {
      let folded = 0;
      for (let b = bytes - 1; b >= 0; b--) folded = folded * 256 + raw[(column * bytes + b) * rows + row];
      out[row * columns + column] = folded % 2 ? -(folded + 1) / 2 : folded / 2;
    }
  }
  return out;
}

// Numbers from what is left of them: each to the row before, or by a prediction from earlier points of a surface.
function addUp(out, columns, { start = null, corners, weights } = {}) {
  for (let row = 0; row < out.length / columns; row++) {
    const first = start ? start[row] : 0, end = start ? start[row + 1] : 0;
    for (let k = 0; k < columns; k++) {
      let told = row && out[(row - 1) * columns + k];
      if (end > first) {
        told = 0;
        for (let i = first; i < end; i++) {
          const [a, b, c] = [0, 1, 2].map((n) => out[corners[4 * i + n] * columns + k]);
          told += a + weights[2 * i] * (b - a) + weights[2 * i + 1] * (c - a);
        }
        told = Math.floor(told / (end - first) + 0.5);
      }
      out[row * columns + k] += told;
    }
  }
  return out;
}

async function unpack(packed, prediction) { return addUp(await unpackRest(packed), packed.columns, prediction); }

// As in prediction.py: across each edge of two triangles the later corner from the other three, sorted by that corner.
function acrossEdges(triangles, points) {
  const seen = new Map(), found = [], start = new Uint32Array(points + 1);
  for (let t = 0; t < triangles.length; t += 3) {
    for (let k = 0; k < 3; k++) {
      const [i, j, corner] = [0, 1, 2].map((n) => triangles[t + ((k + n) % 3)]), a = Math.min(i, j), b = Math.max(i, j);
      const key = a * 2 ** 26 + b, other = seen.get(key);
      seen.set(key, corner);
      if (other === undefined) continue;
      const before = Math.min(other, corner), behind = Math.max(other, corner);
      if (behind > b && behind > before) { found.push([a, b, before, behind]); start[behind + 1]++; }
    }
  }
  for (let i = 0; i < points; i++) start[i + 1] += start[i];
  const corners = new Uint32Array(4 * found.length), at = start.slice(), weights = new Float64Array(2 * found.length);
  for (const each of found) corners.set(each, 4 * at[each[3]]++);
  for (let i = 0; i < found.length; i++) weights.set([1, -1], 2 * i);
  return { start, corners, weights };
}

// By the plane of three corners in place of a parallelogram, where they have one.
function ofPlane({ start, corners, weights }, places) {
  const own = weights.slice(), dot = (p, q) => p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
  for (let i = 0; i < corners.length / 4; i++) {
    const [a, b, c, d] = [0, 1, 2, 3].map((n) => places.subarray(3 * corners[4 * i + n], 3 * corners[4 * i + n] + 3));
    const [u, v, w] = [b, c, d].map((p) => [0, 1, 2].map((axis) => p[axis] - a[axis]));
    const uu = dot(u, u), uv = dot(u, v), vv = dot(v, v), uw = dot(u, w), vw = dot(v, w), area = uu * vv - uv * uv;
    if (!(area > 1e-3 * (uu * vv))) continue;
    const told = [(uw * vv - vw * uv) / area, (vw * uu - uw * uv) / area];
    if (told.every((x) => Math.abs(x) <= 3)) own.set(told.map((x) => Math.floor(x * 64 + 0.5) / 64), 2 * i);
  }
  return { start, corners, weights: own };
}

// A shape by its prediction, or as the difference to an earlier one on the same surface.
async function readShape(packed, surface, known) {
  if (packed.like === undefined) return unpack(packed, surface.plane);
  const out = await unpackRest(packed), other = known[packed.like];
  return out.map((x, i) => x + packed.sign * other[i]);
}

// The motions one after the other: a later one may be like an earlier one.
async function readMotions(motions, surfaces) {
  const known = surfaces.map(() => []), fields = [];
  for (const motion of motions) {
    const surface = surfaces[motion.surface], own = known[motion.surface];
    const shapes = await Promise.all(motion.shapes.map((shape) => readShape(shape, surface, own)));
    const stress = motion.stress && await Promise.all(motion.stress.map((each) => unpack(each, surface.plane)));
    if (!motion.overTime) own.push(...shapes);
    fields.push({ shapes, stress });
  }
  return fields;
}

async function readSurface(given) {
  const [labels, triangles, sides] = await Promise.all(["labels", "triangles", "sides"].map((name) => unpack(given[name])));
  for (let t = 0; t < triangles.length; t += 3) { triangles[t + 1] += triangles[t]; triangles[t + 2] += triangles[t]; }
  const across = acrossEdges(triangles, given.points.rows), places = await unpack(given.points, across);
  return { points: Float32Array.from(places, (x) => x * given.scale), labels, triangles: Uint32Array.from(triangles), sides,
    fewer: given.fewer, plane: ofPlane(across, places) };
}
