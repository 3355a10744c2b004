// WebGL 2: numbers lie in textures, and each thing that is drawn is a run of places in a list of points.

const WIDE = 2048;
const VERTEX = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D; precision highp isampler2D; precision highp usampler2D;
uniform sampler2D places; uniform usampler2D list; uniform isampler2D now, next;
uniform int first; uniform mat3 turn; uniform vec2 pan, fit, scales; uniform float zoom, amp, blend, dot_; uniform int colored;
out vec3 seen; out float value;
ivec2 at(int i) { return ivec2(i & 2047, i >> 11); }
void main() {
  int v = int(texelFetch(list, at(first + gl_VertexID), 0).r);
  vec4 a = vec4(texelFetch(now, at(v), 0)), b = vec4(texelFetch(next, at(v), 0));
  vec3 u = mix(a.xyz * scales.x, b.xyz * scales.y, blend);
  value = colored == 2 ? min(a.w, b.w) < -127.5 ? -1. : mix(a.w, b.w, blend) / 127. : length(u);
  seen = turn * (texelFetch(places, at(v), 0).xyz + amp * u);
  gl_Position = vec4((seen.xy * zoom + pan) * fit, -seen.z * .2, 1.);
  gl_PointSize = dot_;
}`;
const FRAGMENT = `#version 300 es
precision highp float; precision highp int;
in vec3 seen; in float value; uniform vec4 plain; uniform int colored; uniform float peak; uniform bool lit; out vec4 color;
vec3 viridis(float t) {
  return vec3(.2777,.0054,.3341)+t*(vec3(.1051,1.4046,1.3846)+t*(vec3(-.3309,.2148,.0951)+t*(vec3(-4.6342,-5.7991,-19.3324)
    +t*(vec3(6.2283,14.1799,56.6906)+t*(vec3(4.7764,-13.7451,-65.3530)+t*vec3(-5.4355,4.6459,26.3124))))));
}
void main() {
  vec3 n = normalize(cross(dFdx(seen), dFdy(seen)));
  float light = lit ? .52 + .48 * abs(dot(n, normalize(vec3(-.35, .55, .76)))) : 1.;
  bool bare = colored == 0 || value < -.001;
  color = vec4((bare ? plain.rgb : viridis(clamp(value / peak, 0., 1.))) * light, bare ? plain.a : 1.);
}`;
const NAMES = ["places", "list", "now", "next", "first", "turn", "pan", "fit", "scales", "zoom", "amp", "blend", "dot_",
  "colored", "plain", "peak", "lit"];

class Drawing {
  // Null where the browser has no WebGL 2.
  static on(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: false, preserveDrawingBuffer: true });
    return gl && new Drawing(gl);
  }

  constructor(gl) {
    this.gl = gl;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    gl.useProgram(program);
    this.at = Object.fromEntries(NAMES.map((name) => [name, gl.getUniformLocation(program, name)]));
    ["places", "list", "now", "next"].forEach((name, unit) => gl.uniform1i(this.at[name], unit));
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    this.rest = this.texture(new Int16Array(4), 4);
  }

  // Numbers, ``width`` for each point, as a texture of rows of 2048 points.
  texture(values, width) {
    const gl = this.gl, rows = Math.max(1, Math.ceil(values.length / width / WIDE));
    const whole = new values.constructor(rows * WIDE * width);
    whole.set(values);
    const [inner, outer, type] = values instanceof Float32Array ? [gl.RGB32F, gl.RGB, gl.FLOAT]
      : values instanceof Int16Array ? [gl.RGBA16I, gl.RGBA_INTEGER, gl.SHORT] : [gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT];
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.texImage2D(gl.TEXTURE_2D, 0, inner, WIDE, rows, 0, outer, type, whole);
    return texture;
  }

  clear(width, height) {
    const gl = this.gl;
    if (gl.canvas.width !== width || gl.canvas.height !== height) Object.assign(gl.canvas, { width, height });
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  }

  // Everything that follows is seen so; ``box`` is [left, width] of the pane in pixels.
  look(camera, box) {
    const gl = this.gl, height = gl.canvas.height, side = Math.min(box[1], height);
    gl.viewport(box[0], 0, box[1], height);
    gl.uniformMatrix3fv(this.at.turn, true, camera.turn);
    gl.uniform2f(this.at.pan, ...camera.pan);
    gl.uniform2f(this.at.fit, side / box[1], side / height);
    gl.uniform1f(this.at.zoom, camera.zoom);
  }

  // How points move: the textures ``now`` and ``next`` with their scales, mixed by ``blend``, times ``amp``.
  move({ now, next, scales, blend, amp }) {
    const gl = this.gl;
    [now || this.rest, next || now || this.rest].forEach((texture, i) => {
      gl.activeTexture(gl.TEXTURE2 + i);
      gl.bindTexture(gl.TEXTURE_2D, texture);
    });
    gl.activeTexture(gl.TEXTURE0);
    gl.uniform2f(this.at.scales, ...scales);
    gl.uniform1f(this.at.blend, blend);
    gl.uniform1f(this.at.amp, amp);
  }

  run(surface, [first, count], { kind = "TRIANGLES", plain = [0, 0, 0, 1], colored = 0, peak = 1, lit = false, behind = 0, dot = 1 }) {
    if (!count) return;
    const gl = this.gl;
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, surface.list);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, surface.places);
    gl.uniform1i(this.at.first, first);
    gl.uniform4f(this.at.plain, ...plain);
    gl.uniform1i(this.at.colored, colored);
    gl.uniform1f(this.at.peak, peak || 1);
    gl.uniform1i(this.at.lit, lit);
    gl.uniform1f(this.at.dot_, dot);
    gl[behind ? "enable" : "disable"](gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(behind, behind);
    gl.drawArrays(gl[kind], 0, count);
  }

  leave() { this.gl.getExtension("WEBGL_lose_context")?.loseContext(); }
}

// Pairs of points: edges where the skin bends or ends, and edges of elements.
function edgesOf({ points, triangles, sides, fewer }) {
  const normals = new Float32Array(triangles.length), seen = new Map(), bent = [], mesh = [];
  const P = (t, k, axis) => points[3 * triangles[t + k] + axis];
  for (let t = 0; t < triangles.length; t += 3) {
    const [a, b] = [1, 2].map((k) => [0, 1, 2].map((axis) => P(t, k, axis) - P(t, 0, axis)));
    const n = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]], size = Math.hypot(...n) || 1;
    normals.set(n.map((x) => x / size), t);
    // Thin triangles of a coarser skin look anywhere: they bend nothing.
    const thin = fewer && size < 0.3 * Math.max(Math.hypot(...a), Math.hypot(...b), Math.hypot(...a.map((x, k) => x - b[k]))) ** 2;
    if (thin) normals[t] = NaN;
    for (let k = 0; k < 3; k++) {
      const i = triangles[t + k], j = triangles[t + ((k + 1) % 3)], key = Math.min(i, j) * 2 ** 26 + Math.max(i, j);
      const other = seen.get(key);
      if (other === undefined) {
        seen.set(key, t);
        if (sides[t / 3] & (1 << k)) mesh.push(i, j);
      } else {
        // Forty degrees: walls of holes are smoother.
        if ((other < 0 && !fewer) || [0, 1, 2].reduce((sum, axis) => sum + normals[t + axis] * normals[other + axis], 0) < 0.77) bent.push(i, j);
        seen.set(key, -1);
      }
    }
  }
  for (const [key, t] of seen) if (t >= 0) bent.push(Math.floor(key / 2 ** 26), key % 2 ** 26);
  return { bent: fewer ? chained(bent) : bent, mesh };
}

// Edges without those that end alone, as thin triangles of a coarser skin have them: what is left bends along a line.
function chained(pairs) {
  for (let turn = 0; turn < 4; turn++) {
    const ends = new Map(), kept = [];
    for (const v of pairs) ends.set(v, (ends.get(v) || 0) + 1);
    for (let k = 0; k < pairs.length; k += 2) if (ends.get(pairs[k]) > 1 && ends.get(pairs[k + 1]) > 1) kept.push(pairs[k], pairs[k + 1]);
    pairs = kept;
  }
  return pairs;
}
