// The panel beside the picture, and the names over it.

Object.assign(Viewer.prototype, {
  build() {
    const { data } = this;
    this.stage = make("div", { className: "stage" });
    this.cover = make("canvas", { className: "cover" });
    this.cover.setAttribute("aria-hidden", "true");
    this.tip = make("div", { className: "tip", hidden: true });
    this.stage.append(this.cover, this.tip);
    this.panel = make("div", { className: "panel" });
    const parts = [data.motions.length ? this.motionPart() : null, this.lookPart(), data.picks ? this.pickPart() : null,
      data.groups.length ? this.groupPart() : null, this.notePart()];
    this.panel.append(...parts.filter(Boolean));
    this.root.querySelector(".still")?.remove();
    this.root.append(make("div", { className: "viewer" }, this.stage, this.panel));
    new ResizeObserver(() => { this.fit(); }).observe(this.stage);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.touch());
  },

  field(label, control) { return make("label", {}, make("span", {}, label), control); },

  range(label, given, set) {
    return this.field(label, make("input", { type: "range", ...given, oninput: (e) => { set(+e.target.value); this.touch(); } }));
  },

  check(label, key) {
    return make("label", { className: "check" }, make("input", { type: "checkbox", checked: this.show[key],
      onchange: (e) => { this.show[key] = e.target.checked; this.touch(); } }), make("span", {}, label));
  },

  value(motion, mode) {
    const { values, overTime } = this.data.motions[motion];
    return overTime ? `${short(values[mode])} s` : `${short(values[mode], 5)} Hz`;
  },

  modeNames(motion) {
    return this.data.motions[motion].values.map((_, i) => new Option(`${i + 1}: ${this.value(motion, i)}`, i));
  },

  motionPart() {
    const { data, panes } = this, part = make("fieldset", {}, make("legend", {}, "Motion"));
    const bodies = () => data.motions.map((motion, i) => new Option(motion.name, i));
    const over = () => data.motions[panes[0].motion].overTime;
    this.modes = make("select", { className: "modes", size: 7, onchange: () => this.choose(0, +this.modes.value) });
    this.body = make("select", { onchange: () => this.chooseBody(0, +this.body.value) });
    this.body.append(...bodies());
    if (data.motions.length > 1) part.append(this.field("Body", this.body));
    if (!over()) part.append(this.field("Mode", this.modes));
    if (data.motions.length > 1) {
      this.second = make("select", { onchange: () => this.chooseBody(1, +this.second.value) });
      this.second.append(new Option("nothing", -1), ...bodies());
      this.second.value = panes[1] ? panes[1].motion : -1;
      this.otherModes = make("select", { onchange: () => this.choose(1, +this.otherModes.value) });
      this.otherField = this.field("Its mode", this.otherModes);
      this.macBox = make("details", { className: "mac" }, make("summary", {}, "MAC of all modes"), make("div", { className: "scroll", tabIndex: 0 }));
      part.append(this.field("Beside it", this.second), this.otherField, this.macBox);
    }
    this.playButton = make("button", { type: "button", onclick: () => this.play() });
    part.append(make("div", { className: "row" }, this.playButton));
    if (over()) {
      this.timeText = make("output");
      this.timeSlider = make("input", { type: "range", min: 0, max: 1, step: 0.001, value: 0, oninput: () => {
        this.play(false); this.time = Math.min(0.999999, +this.timeSlider.value); this.clock = 6 * this.time; this.sliders(); this.touch(); } });
      part.append(this.field("Time", this.timeSlider), this.timeText);
    }
    part.append(this.range("Amplitude", { min: 0, max: 3, step: 0.05, value: 1 }, (x) => { this.amplitude = x; this.sliders(); }));
    part.append(this.range("Speed", { min: 0.1, max: 3, step: 0.1, value: 1 }, (x) => { this.speed = x; }));
    const colors = make("select", { onchange: () => { this.color = colors.value; this.touch(); } });
    colors.append(new Option("displacement"));
    if (data.motions.some((motion) => motion.stress)) colors.append(new Option("von Mises stress", "stress"));
    colors.append(new Option("one color", "none"));
    part.append(this.field("Color", colors));
    this.refill();
    this.play(this.playing);
    return part;
  },

  refill() {
    const [one, two] = this.panes;
    this.modes.replaceChildren(...this.modeNames(one.motion));
    this.modes.value = one.mode;
    this.body.value = one.motion;
    if (!this.second) return;
    this.second.value = two ? two.motion : -1;
    this.otherField.hidden = this.macBox.hidden = !two;
    if (!two) return;
    const mac = this.mac();
    this.otherModes.replaceChildren(...this.modeNames(two.motion));
    this.otherModes.value = two.mode;
    if (mac) for (const option of this.otherModes.options) option.textContent += `, MAC ${mac[one.mode][option.value].toFixed(2)}`;
    this.macBox.hidden = !mac;
    if (!mac) return;
    const head = make("tr", {}, make("td"), ...mac[0].map((_, j) => make("th", { scope: "col" }, String(j + 1))));
    const rows = mac.map((row, i) => make("tr", {}, make("th", { scope: "row" }, String(i + 1)), ...row.map((x, j) => {
      const cell = make("td", { onclick: () => { this.choose(0, i); this.choose(1, j); } }, x.toFixed(2));
      cell.style.setProperty("--mac", `${Math.round(70 * x)}%`);
      if (i === one.mode && j === two.mode) cell.className = "chosen";
      return cell;
    })));
    const caption = make("caption", {}, `${this.data.motions[one.motion].name} down, ${this.data.motions[two.motion].name} across`);
    this.macBox.lastChild.replaceChildren(make("table", {}, caption, head, ...rows));
  },

  mac() {
    const [i, j] = this.panes.map((pane) => pane.motion);
    const known = this.data.mac.find(([a, b]) => (a === i && b === j) || (a === j && b === i));
    if (!known) return null;
    return known[0] === i ? known[2] : known[2][0].map((_, column) => known[2].map((row) => row[column]));
  },

  choose(pane, mode) {
    this.panes[pane].mode = mode;
    const mac = pane === 0 && this.panes[1] && this.mac();
    if (mac) this.panes[1].mode = mac[mode].indexOf(Math.max(...mac[mode]));
    this.refill();
    this.touch();
  },

  chooseBody(pane, motion) {
    if (motion < 0) this.panes.length = 1;
    else this.panes[pane] = { motion, mode: Math.min(this.panes[pane]?.mode || 0, this.data.motions[motion].values.length - 1) };
    this.choose(0, this.panes[0].mode);
    this.fit();
  },

  play(on = !this.playing) {
    this.playing = on;
    if (!on && !this.data.motions[this.panes[0].motion].overTime) this.phase = 1;
    this.playButton.textContent = on ? "Stop" : "Play";
    this.playButton.setAttribute("aria-pressed", on);
    this.touch();
  },

  sliders() {
    if (!this.timeSlider) return;
    const { motion } = this.panes[0], { values } = this.data.motions[motion];
    this.timeSlider.value = this.time;
    const shown = short(this.magnification(motion), 3);
    this.timeText.textContent = `${short(values[0] + this.time * (values[values.length - 1] - values[0]))} s, drawn ${shown} times as large`;
  },

  lookPart() {
    const views = Object.keys(VIEWS).map((name) => make("button", { type: "button", onclick: () => this.turnTo(name) }, name));
    const part = make("fieldset", {}, make("legend", {}, "View"));
    part.append(make("div", { className: "row axes" }, make("button", { type: "button", onclick: () => this.turnTo("0") }, "first"), ...views));
    part.append(make("div", { className: "row" }, make("button", { type: "button", onclick: () => this.fit() }, "Fit"),
      make("button", { type: "button", onclick: () => this.save() }, "Save picture")));
    if (this.data.motions.length) part.append(this.check("undeformed edges", "ghost"));
    part.append(this.check("mesh", "mesh"));
    if (this.data.frames.length) part.append(this.check(`interfaces: ${this.data.frames.map((frame) => frame.name).join(", ")}`, "names"));
    return part;
  },

  pickPart() {
    this.boxButton = make("button", { type: "button", onclick: () => this.drawBox(!this.boxing) }, "Draw a box");
    this.boxButton.setAttribute("aria-pressed", "false");
    this.found = make("div", { className: "found", role: "status" }, make("p", { className: "soft" }, "Click the part, or draw a box over it: the selection as a line of a job."));
    return make("fieldset", {}, make("legend", {}, "Select nodes"), make("div", { className: "row" }, this.boxButton), this.found);
  },

  drawBox(on) {
    this.boxing = on;
    this.boxButton.setAttribute("aria-pressed", on);
    this.stage.classList.toggle("boxing", on);
  },

  // Lines of a job, each with a button that copies it.
  offer(lines) {
    // Texts of JSON are texts of TOML too.
    const quoted = (text) => `nodes = ${JSON.stringify(text)}`;
    this.found.replaceChildren(...lines.map(({ line, about }) => make("div", { className: "line" }, make("code", {}, quoted(line)),
      make("button", { type: "button", onclick: (e) => this.copy(e.target, quoted(line)) }, "Copy"), make("span", { className: "soft" }, about))));
    if (!lines.length) this.found.replaceChildren(make("p", { className: "soft" }, "No node of the part is seen there."));
  },

  async copy(button, text) {
    try { await navigator.clipboard.writeText(text); } catch {
      const field = make("textarea", { value: text });
      button.after(field); field.select(); document.execCommand("copy"); field.remove();
    }
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = "Copy"; }, 1500);
  },

  groupPart() {
    const part = make("fieldset", {}, make("legend", {}, "Shown"));
    const order = ["error", "warning", "note", "interface", "coupling", "nodes", "elements"];
    const lists = order.map((kind) => this.groups.filter((group) => group.kind === kind)).flat();
    const list = make("ul", { className: "groups" }, ...lists.map((group) => {
      const box = make("input", { type: "checkbox", checked: group.shown, onchange: () => { group.shown = box.checked; this.touch(); } });
      const swatch = make("span", { className: "swatch" });
      swatch.style.background = `rgb(${group.color.map((x) => Math.round(255 * x))})`;
      const words = group.kind in GRAVE ? `${group.kind}: ${group.about}` : `${group.name} (${group.count.toLocaleString("en")} ${{ elements: "elements", coupling: "joined nodes" }[group.kind] || "nodes"})`;
      const there = group.nodes.length ? make("button", { type: "button", onclick: () => this.goTo(group) }, "Go to") : null;
      return make("li", {}, make("label", { className: "check" }, box, swatch, make("span", {}, words)), there);
    }));
    if (lists.length > 12) {
      part.append(this.field("Filter", make("input", { type: "search", oninput: (e) => {
        for (const item of list.children) item.hidden = !item.textContent.toLowerCase().includes(e.target.value.toLowerCase());
      } })));
    }
    part.append(list);
    return part;
  },

  // The points of a group in the middle of the picture, close.
  goTo(group) {
    const { points } = this.surfaces[0], { turn } = this.camera;
    const mean = [0, 1, 2].map((axis) => group.nodes.reduce((sum, v) => sum + points[3 * v + axis], 0) / group.nodes.length);
    group.shown = true;
    this.camera.zoom = Math.max(this.camera.zoom, 4);
    this.camera.pan = [0, 1].map((k) => -this.camera.zoom * (turn[3 * k] * mean[0] + turn[3 * k + 1] * mean[1] + turn[3 * k + 2] * mean[2]));
    this.touch();
  },

  notePart() {
    const lines = this.data.notes.map((note) => make("p", { className: "soft" }, note));
    return make("details", { className: "help", open: lines.length > 0 }, make("summary", {}, "Keys and notes"), ...lines, make("p", { className: "soft" }, KEYS));
  },

  save() {
    if (!this.begin()) return;
    this.paint();
    make("a", { href: this.picture().toDataURL("image/png"), download: `${this.data.title.replace(/[^\w.-]+/g, "_")}.png` }).click();
  },

  // Names, the scale of colors and the drawn box, over the picture.
  over(ink) {
    const { width, height, ratio } = this.size(), { cover, data, camera } = this, brush = cover.getContext("2d");
    if (cover.width !== width * ratio || cover.height !== height * ratio) Object.assign(cover, { width: width * ratio, height: height * ratio });
    brush.setTransform(ratio, 0, 0, ratio, 0, 0);
    brush.clearRect(0, 0, width, height);
    const color = `rgb(${ink.map((x) => Math.round(255 * x))})`, paper = this.printing ? "#fff" : getComputedStyle(this.stage).backgroundColor;
    brush.font = "13px system-ui, sans-serif";
    brush.lineWidth = 4;
    brush.lineJoin = "round";
    const write = (text, x, y) => { brush.strokeStyle = paper; brush.fillStyle = color; brush.strokeText(text, x, y); brush.fillText(text, x, y); };
    this.boxes().forEach((box, i) => {
      const half = Math.min(box[1], height) / 2, pane = this.panes[i];
      const spot = (p) => [0, 1].map((k) => [0, 1, 2].reduce((sum, axis) => sum + camera.turn[3 * k + axis] * p[axis], 0) * camera.zoom + camera.pan[k])
        .map((value, k) => (k ? height / 2 - half * value : box[0] + box[1] / 2 + half * value));
      for (const frame of this.show.names ? data.frames : []) {
        const { name } = frame, { origin, axes } = this.frameIn(pane, frame), [x, y] = spot(origin);
        ["#d33", "#2a2", "#36d"].forEach((stroke, axis) => {
          const end = spot(origin.map((value, k) => value + (axes[axis][k] * 0.09) / Math.max(0.6, camera.zoom)));
          Object.assign(brush, { strokeStyle: stroke, lineWidth: 2 });
          brush.beginPath(); brush.moveTo(x, y); brush.lineTo(...end); brush.stroke();
        });
        brush.lineWidth = 4;
        // Names stay within their pane.
        write(name, Math.max(box[0] + 4, Math.min(x + 6, box[0] + box[1] - brush.measureText(name).width - 6)), y - 7);
      }
      if (pane.motion >= 0) {
        const { name, overTime } = data.motions[pane.motion];
        write(overTime ? name : `${name}, mode ${pane.mode + 1}: ${this.value(pane.motion, pane.mode)}`, box[0] + 12, 22);
      }
      if (i) { brush.fillStyle = color; brush.globalAlpha = 0.25; brush.fillRect(box[0], 0, 1, height); brush.globalAlpha = 1; }
    });
    if (this.panes[0].motion >= 0 && this.color !== "none") this.legend(brush, write, height);
    if (this.drawn) {
      const [a, b, c, d] = this.drawn;
      Object.assign(brush, { strokeStyle: color, lineWidth: 1.5 });
      brush.setLineDash([5, 4]); brush.strokeRect(a, b, c - a, d - b); brush.setLineDash([]);
    }
  },

  legend(brush, write, height) {
    const { motion, mode } = this.panes[0], given = this.data.motions[motion], stressed = this.color === "stress" && given.stress;
    const top = height - 30, slope = brush.createLinearGradient(12, 0, 152, 0);
    // Viridis at its quarters.
    ["#440154", "#3b528b", "#21918c", "#5ec962", "#fde725"].forEach((color, i) => slope.addColorStop(i / 4, color));
    brush.fillStyle = slope;
    brush.fillRect(12, top, 140, 8);
    const most = stressed ? this.stressScale(motion, mode) * 127 : this.peak(motion, mode);
    const [scale, unit] = stressed ? [1e6, "MPa"] : [this.data.unit.length, this.data.unit.name];
    write("0", 12, top + 22);
    write(given.overTime ? `${short(most / scale, 3)} ${unit}` : "largest", 130, top + 22);
    write(stressed ? "von Mises stress" : "displacement", 12, top - 6);
  },
});

mountAll(document);
