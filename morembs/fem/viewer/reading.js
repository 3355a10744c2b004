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

// Row by row, as numbers; 32-bit integers need no more.
async function unpack({ rows, columns, bytes, data }) {
  const raw = await inflate(Uint8Array.from(atob(data), (c) => c.charCodeAt(0)));
  const out = new Float64Array(rows * columns);
  for (let column = 0; column < columns; column++) {
    for (let row = 0, sum = 0; row < rows; row++) {
      let folded = 0;
      for (let b = bytes - 1; b >= 0; b--) folded = folded * 256 + raw[(column * bytes + b) * rows + row];
      sum += folded % 2 ? -(folded + 1) / 2 : folded / 2;
      out[row * columns + column] = sum;
    }
  }
  return out;
}

async function readSurface(given) {
  const [points, labels, triangles, sides] = await Promise.all(
    ["points", "labels", "triangles", "sides"].map((name) => unpack(given[name])));
  for (let t = 0; t < triangles.length; t += 3) { triangles[t + 1] += triangles[t]; triangles[t + 2] += triangles[t]; }
  return { points: Float32Array.from(points, (x) => x * given.scale), labels, triangles: Uint32Array.from(triangles), sides,
    fewer: given.fewer };
}
