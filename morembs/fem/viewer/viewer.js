// One viewer: a canvas with names over it, and a panel beside. Names of a model become text, never HTML.

const HUES = [[0, 0.45, 0.7], [0.9, 0.6, 0], [0, 0.62, 0.45], [0.8, 0.47, 0.65], [0.34, 0.7, 0.91], [0.84, 0.37, 0], [0.55, 0.4, 0.8], [0.6, 0.55, 0.1]];
const GRAVE = { error: [0.85, 0.1, 0.15], warning: [0.95, 0.55, 0], note: [0.2, 0.5, 0.9] };
const VIEWS = { "+x": [0, 1, 0, 0, 0, 1, 1, 0, 0], "-x": [0, -1, 0, 0, 0, 1, -1, 0, 0], "+y": [-1, 0, 0, 0, 0, 1, 0, 1, 0],
  "-y": [1, 0, 0, 0, 0, 1, 0, -1, 0], "+z": [1, 0, 0, 0, 1, 0, 0, 0, 1], "-z": [-1, 0, 0, 0, 1, 0, 0, 0, -1] };
const KEYS = "Drag turns, with Shift or the right button it moves, the wheel zooms. Keys: arrows turn, + and - zoom, 1 to 6 look along "
  + "the axes, 0 as at first, F fits, Space starts and stops, N and P step through modes, U undeformed edges, M mesh, B draws a box, S saves a picture.";
// Browsers keep sixteen drawings of a page at most.
const LIVE = new Set(), MOST_LIVE = 8;

function make(tag, given = {}, ...inner) {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(given)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (key in element && key !== "list") element[key] = value;
    else element.setAttribute(key, value);
  }
  element.append(...inner.filter((part) => part !== null && part !== undefined));
  return element;
}

const short = (x, digits = 4) => (x === 0 ? "0" : Math.abs(x) >= 1e6 || Math.abs(x) < 1e-3 ? x.toExponential(digits - 2)
  : x.toLocaleString("en", { maximumSignificantDigits: Math.max(digits, Math.ceil(Math.log10(Math.abs(x) + 1))) }));

class Viewer {
  constructor(root, data) {
    Object.assign(this, { root, data, phase: 1, time: 0, clock: 0, amplitude: 1, speed: 1, color: "displacement", drawing: null });
    this.camera = { turn: data.view.flat(), zoom: 1, pan: [0, 0] };
    this.show = { ghost: data.motions.length > 0, mesh: !data.motions.length, names: true };
    this.playing = data.motions.length > 0 && !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.panes = data.motions.length ? [{ motion: 0, mode: 0 }] : [{ motion: -1, mode: 0 }];
    if (data.sideBySide) this.panes.push({ motion: 1, mode: 0 });
    this.frame = this.frame.bind(this);
  }

  async start() {
    const { data } = this;
    this.surfaces = await Promise.all(data.surfaces.map(readSurface));
    this.fields = await readMotions(data.motions, this.surfaces);
    this.owner = data.owner && await unpack(data.owner);
    this.groups = await Promise.all(data.groups.map(async (given, i) => {
      const parts = {};
      for (const key of ["triangles", "nodes", "lines"]) parts[key] = given[key] ? await unpack(given[key]) : [];
      return { about: "", select: "", ...given, ...parts, members: new Set(parts.nodes), faces: new Set(parts.triangles),
        color: GRAVE[given.kind] || HUES[i % HUES.length], shown: given.kind in GRAVE || given.kind === "interface" };
    }));
    this.surfaces.forEach((surface, number) => this.list(surface, number));
    if (data.picks) this.picker = new Picker(data, this.surfaces[0], this.groups, this.owner);
    this.build();
    this.fit();
  }

  // All that is drawn of a surface as one list of points, with the runs of it.
  list(surface, number) {
    const { bent, mesh } = edgesOf(surface), parts = [], runs = {};
    let end = 0;
    const run = (points) => { parts.push(points); end += points.length; return [end - points.length, points.length]; };
    Object.assign(runs, { skin: run(surface.triangles), bent: run(bent), mesh: run(mesh) });
    for (const group of number ? [] : this.groups) {
      const corners = [];
      for (const t of group.triangles) corners.push(...surface.triangles.subarray(3 * t, 3 * t + 3));
      group.runs = { triangles: run(corners), nodes: run(group.nodes), lines: run(group.lines) };
    }
    surface.runs = runs;
    surface.points4list = new Uint32Array(end);
    let at = 0;
    for (const part of parts) { surface.points4list.set(part, at); at += part.length; }
  }

  // A canvas of its own each time, as a lost drawing does not come back.
  begin() {
    if (this.drawing) return true;
    for (const other of LIVE) if (LIVE.size >= MOST_LIVE && other !== this) other.end();
    const canvas = make("canvas", { className: "picture", tabIndex: 0, role: "application" });
    canvas.setAttribute("aria-label", `${this.data.title}: a picture to turn. ${KEYS}`);
    this.drawing = Drawing.on(canvas);
    if (!this.drawing) return false;
    this.canvas?.remove();
    this.canvas = canvas;
    this.stage.prepend(canvas);
    for (const surface of this.surfaces) {
      surface.places = this.drawing.texture(surface.points, 3);
      surface.list = this.drawing.texture(surface.points4list, 1);
    }
    this.textures = new Map();
    this.listen();
    LIVE.add(this);
    return true;
  }

  end() {
    this.drawing?.leave();
    this.drawing = null;
    LIVE.delete(this);
  }

  // The shape of a motion as a texture: displacements, and stress where that colors.
  texture(motion, number) {
    const key = `${motion} ${number}`;
    if (this.textures.has(key)) return this.textures.get(key);
    const { shapes, stress } = this.fields[motion], given = this.data.motions[motion], n = shapes[number].length / 3;
    const whole = new Int16Array(4 * n), share = stress ? given.stress[number].scale / this.stressScale(motion, number) : 0;
    for (let i = 0; i < n; i++) {
      whole.set(shapes[number].subarray(3 * i, 3 * i + 3), 4 * i);
      if (stress) whole[4 * i + 3] = stress[number][i] < -127 ? -128 : Math.round(stress[number][i] * share);
    }
    // A motion over time has many steps; a few of them are kept.
    if (this.textures.size > 24) { for (const old of this.textures.values()) this.drawing.gl.deleteTexture(old); this.textures.clear(); }
    const texture = this.drawing.texture(whole, 4);
    this.textures.set(key, texture);
    return texture;
  }

  stressScale(motion, number) {
    const { stress, overTime } = this.data.motions[motion];
    return overTime ? Math.max(...stress.map((each) => each.scale)) : stress[number].scale;
  }

  peak(motion, number) {
    const given = this.data.motions[motion], field = this.fields[motion];
    field.peaks ||= [];
    if (!field.peaks.length) {
      field.peaks = field.shapes.map((shape, i) => {
        let most = 0;
        for (let k = 0; k < shape.length; k += 3) most = Math.max(most, shape[k] ** 2 + shape[k + 1] ** 2 + shape[k + 2] ** 2);
        return Math.sqrt(most) * given.shapes[i].scale;
      });
    }
    return given.overTime ? Math.max(...field.peaks) : field.peaks[number];
  }

  // How a pane moves now.
  moved(pane) {
    if (pane.motion < 0) return { numbers: [0, 0], scales: [0, 0], blend: 0, amp: 0, peak: 1 };
    const given = this.data.motions[pane.motion], { values } = given;
    let i = pane.mode, j = i, blend = 0;
    if (given.overTime) {
      const t = values[0] + this.time * (values[values.length - 1] - values[0]);
      for (i = 0; i < values.length - 2 && values[i + 1] <= t; i++);
      j = Math.min(i + 1, values.length - 1);
      blend = j > i ? (t - values[i]) / (values[j] - values[i]) : 0;
    }
    const peak = this.peak(pane.motion, i);
    const amp = given.overTime ? this.magnification(pane.motion) / this.data.half : (0.12 * this.amplitude * this.phase) / (peak || 1);
    return { numbers: [i, j], scales: [given.shapes[i].scale, given.shapes[j].scale], blend, amp, peak };
  }

  // Over time a power of ten that makes the motion seen; true to scale where it is seen as it is.
  magnification(motion) {
    const seen = this.peak(motion, 0) / this.data.half;
    return this.amplitude * (seen > 0.02 || !seen ? 1 : 10 ** Math.floor(Math.log10(0.15 / seen)));
  }

  size() {
    const { clientWidth: width, clientHeight: height } = this.stage;
    return { width, height, ratio: devicePixelRatio || 1 };
  }

  boxes() {
    const { width } = this.size(), count = this.panes.length;
    return this.panes.map((_, i) => [(width * i) / count, width / count]);
  }

  surfaceOf(pane) { return this.surfaces[pane.motion < 0 ? 0 : this.data.motions[pane.motion].surface]; }

  fit() {
    const { width, height } = this.size(), box = width / this.panes.length, side = Math.min(box, height) || 1;
    const low = [Infinity, Infinity], high = [-Infinity, -Infinity], { turn } = this.camera;
    for (const { points } of this.surfaces) {
      for (let i = 0; i < points.length; i += 3) {
        for (const k of [0, 1]) {
          const x = turn[3 * k] * points[i] + turn[3 * k + 1] * points[i + 1] + turn[3 * k + 2] * points[i + 2];
          low[k] = Math.min(low[k], x); high[k] = Math.max(high[k], x);
        }
      }
    }
    const room = 0.78 * 2;
    this.camera.zoom = Math.min((room * box) / side / (high[0] - low[0] || 1), (room * height) / side / (high[1] - low[1] || 1));
    this.camera.pan = [0, 1].map((k) => (-(low[k] + high[k]) / 2) * this.camera.zoom);
    this.touch();
  }

  touch() {
    if (!this.due) { this.due = true; requestAnimationFrame(this.frame); }
  }

  frame(now) {
    this.due = false;
    if (!this.seen || !this.begin()) return;
    const step = Math.min(0.1, (now - (this.last || now)) / 1000);
    this.last = now;
    if (this.playing) {
      this.clock += step * this.speed;
      this.phase = Math.sin((2 * Math.PI * this.clock) / 1.6);
      this.time = (this.clock / 6) % 1;
      this.sliders();
      this.touch();
    } else this.last = 0;
    this.paint();
  }

  paint() {
    const { width, height, ratio } = this.size(), dark = !this.printing && matchMedia("(prefers-color-scheme: dark)").matches;
    const ink = dark ? [0.85, 0.88, 0.92] : [0.1, 0.13, 0.17], body = dark ? [0.5, 0.55, 0.61] : [0.72, 0.75, 0.79];
    this.drawing.clear(Math.round(width * ratio), Math.round(height * ratio));
    this.panes.forEach((pane, i) => {
      const surface = this.surfaceOf(pane), { runs } = surface, box = this.boxes()[i].map((x) => Math.round(x * ratio));
      const { numbers, peak, ...move } = this.moved(pane);
      const [now, next] = pane.motion < 0 ? [null, null] : numbers.map((number) => this.texture(pane.motion, number));
      const stressed = this.color === "stress" && this.fields[pane.motion]?.stress;
      const colored = pane.motion < 0 || this.color === "none" ? 0 : stressed ? 2 : 1;
      this.drawing.look(this.camera, box);
      this.drawing.move({ now, next, ...move });
      this.drawing.run(surface, runs.skin, { plain: [...body, 1], colored, peak: stressed ? 1 : peak, lit: true, behind: 2 });
      for (const group of i ? [] : this.groups.filter((each) => each.shown)) {
        this.drawing.run(surface, group.runs.triangles, { plain: [...group.color, 1], lit: true, behind: 1 });
        this.drawing.run(surface, group.runs.lines, { kind: "LINES", plain: [...group.color, 1] });
        this.drawing.run(surface, group.runs.nodes, { kind: "POINTS", plain: [...group.color, 1], dot: (group.kind in GRAVE ? 9 : 5) * ratio });
      }
      if (this.show.mesh) this.drawing.run(surface, runs.mesh, { kind: "LINES", plain: [...ink, 0.28] });
      this.drawing.run(surface, runs.bent, { kind: "LINES", plain: [...ink, 0.6] });
      if (this.show.ghost && pane.motion >= 0) {
        this.drawing.move({ scales: [0, 0], blend: 0, amp: 0 });
        this.drawing.run(surface, runs.bent, { kind: "LINES", plain: [...ink, 0.4] });
      }
    });
    this.over(ink);
  }

  printCover() {
    const brush = this.cover.getContext("2d"), { width, height } = this.cover;
    brush.setTransform(1, 0, 0, 1, 0, 0);
    brush.globalCompositeOperation = "destination-over";
    brush.drawImage(this.canvas, 0, 0, width, height);
    brush.globalCompositeOperation = "source-over";
  }

  // A picture with all that is over it, on paper.
  picture() {
    const { canvas, width, height } = { canvas: this.canvas, width: this.canvas.width, height: this.canvas.height };
    const whole = make("canvas", { width, height }), brush = whole.getContext("2d");
    brush.fillStyle = getComputedStyle(this.stage).backgroundColor;
    brush.fillRect(0, 0, width, height);
    brush.drawImage(canvas, 0, 0);
    brush.drawImage(this.cover, 0, 0, width, height);
    return whole;
  }
}

let webgl = null;
function hasWebGL() {
  if (webgl === null) {
    const gl = document.createElement("canvas").getContext("webgl2");
    webgl = Boolean(gl);
    gl?.getExtension("WEBGL_lose_context")?.loseContext();
  }
  return webgl;
}

// Fill every viewer of a document that can be seen, when it is seen.
function mountAll(root) {
  const watch = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      const viewer = target.viewer;
      if (viewer?.stage) { viewer.seen = isIntersecting; if (isIntersecting) viewer.touch(); continue; }
      if (!isIntersecting || viewer) continue;
      if (!hasWebGL()) {
        target.viewer = {};
        target.append(make("p", {}, "This browser has no WebGL 2, so the picture does not move."));
        continue;
      }
      const data = JSON.parse(target.querySelector("script").textContent);
      target.viewer = new Viewer(target, data);
      target.viewer.seen = true;
      target.viewer.start();
    }
  }, { rootMargin: "200px" });
  for (const each of root.querySelectorAll(".morembs-viewer")) watch.observe(each);
  // Paper is light, and takes nothing of WebGL where a page is printed that is not seen: what is over it has all.
  for (const kind of ["beforeprint", "afterprint"]) {
    addEventListener(kind, () => {
      for (const viewer of LIVE) {
        viewer.printing = kind === "beforeprint";
        viewer.paint();
        if (viewer.printing) viewer.printCover();
      }
    });
  }
}
