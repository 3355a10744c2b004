// What pointer and keys do: they turn the part, point at nodes and select them.

Object.assign(Viewer.prototype, {
  turnTo(name) {
    this.camera.turn = [...(VIEWS[name] || this.data.view.flat())];
    this.fit();
  },

  // Turn about the axes of the picture.
  turn(right, up) {
    const [c, s, d, e] = [Math.cos(right), Math.sin(right), Math.cos(up), Math.sin(up)], old = this.camera.turn;
    const R = [c, 0, s, e * s, d, -e * c, -d * s, e, d * c];
    this.camera.turn = R.map((_, i) => [0, 1, 2].reduce((sum, k) => sum + R[3 * Math.floor(i / 3) + k] * old[3 * k + (i % 3)], 0));
    this.touch();
  },

  zoom(factor, x = null, y = null) {
    const { width, height } = this.size(), box = width / this.panes.length, half = Math.min(box, height) / 2;
    const at = x === null ? [0, 0] : [((x % box) - box / 2) / half, (height / 2 - y) / half];
    this.camera.zoom *= factor;
    this.camera.pan = this.camera.pan.map((p, k) => at[k] + (p - at[k]) * factor);
    this.touch();
  },

  listen() {
    const { canvas } = this;
    let held = null;
    const place = (e) => { const at = canvas.getBoundingClientRect(); return [e.clientX - at.left, e.clientY - at.top]; };
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("pointerdown", (e) => {
      canvas.setPointerCapture(e.pointerId);
      held = { from: place(e), last: place(e), moves: e.button === 2 || e.shiftKey, far: 0 };
    });
    canvas.addEventListener("pointermove", (e) => {
      const [x, y] = place(e);
      if (!held) { this.hover = [x, y]; this.point(); return; }
      const [dx, dy] = [x - held.last[0], y - held.last[1]];
      held.far += Math.hypot(dx, dy);
      held.last = [x, y];
      this.tip.hidden = true;
      if (this.boxing) { this.drawn = [...held.from, x, y]; this.touch(); return; }
      const { width, height } = this.size(), half = Math.min(width / this.panes.length, height) / 2;
      if (held.moves) { this.camera.pan = [this.camera.pan[0] + dx / half, this.camera.pan[1] - dy / half]; this.touch(); }
      else this.turn(dx / 120, dy / 120);
    });
    canvas.addEventListener("pointerup", (e) => {
      if (this.picker && this.boxing && this.drawn) this.pickBox();
      else if (this.picker && held && held.far < 4) this.pickAt(...place(e));
      held = this.drawn = null;
      this.touch();
    });
    canvas.addEventListener("pointerleave", () => { this.hover = null; this.tip.hidden = true; });
    canvas.addEventListener("wheel", (e) => { e.preventDefault(); this.zoom(Math.exp(-e.deltaY / 600), ...place(e)); }, { passive: false });
    canvas.addEventListener("keydown", (e) => this.key(e));
  },

  key(e) {
    const { panes, data } = this, moving = data.motions.length > 0, count = moving && data.motions[panes[0].motion].values.length;
    const flip = (name) => { this.show[name] = !this.show[name]; this.touch(); };
    const acts = { ArrowLeft: () => this.turn(-0.15, 0), ArrowRight: () => this.turn(0.15, 0), ArrowUp: () => this.turn(0, -0.15),
      ArrowDown: () => this.turn(0, 0.15), "+": () => this.zoom(1.2), "=": () => this.zoom(1.2), "-": () => this.zoom(1 / 1.2),
      0: () => this.turnTo("0"), f: () => this.fit(), m: () => flip("mesh"), u: () => flip("ghost"), s: () => this.save(),
      " ": () => moving && this.play(), n: () => moving && this.choose(0, (panes[0].mode + 1) % count),
      p: () => moving && this.choose(0, (panes[0].mode + count - 1) % count), b: () => this.picker && this.drawBox(!this.boxing) };
    Object.keys(VIEWS).forEach((name, i) => { acts[i + 1] = () => this.turnTo(name); });
    const act = acts[e.key.length === 1 ? e.key.toLowerCase() : e.key];
    if (!act || e.ctrlKey || e.metaKey || e.altKey) return;
    e.preventDefault();
    act();
  },

  // The pane under a place, its surface, and where its points are on the canvas.
  under(x) {
    const { width, height } = this.size(), i = Math.min(this.panes.length - 1, Math.floor((x * this.panes.length) / width));
    const pane = this.panes[i], surface = this.surfaceOf(pane);
    return { surface, at: projected(surface, this.shapeOf(pane), this.camera, this.boxes()[i], height) };
  },

  // Label and coordinates of the node under the pointer.
  point() {
    if (this.pointing) return;
    this.pointing = requestAnimationFrame(() => {
      this.pointing = null;
      if (!this.hover) return;
      const [x, y] = this.hover, { surface, at } = this.under(x), hit = hitAt(surface.triangles, at, x, y);
      this.tip.hidden = !hit;
      if (!hit) return;
      const { data } = this, where = [0, 1, 2].map((axis) => (data.middle[axis] + data.half * surface.points[3 * hit.node + axis]) / data.unit.length);
      this.tip.textContent = `node ${surface.labels[hit.node]}: ${where.map((v) => short(v, 5)).join(", ")} ${data.unit.name}`;
      this.tip.style.left = `${Math.min(x + 14, this.size().width - this.tip.offsetWidth - 4)}px`;
      this.tip.style.top = `${Math.max(2, y - 30)}px`;
    });
  },

  pickAt(x, y) {
    const { surface, at } = this.under(x), hit = hitAt(surface.triangles, at, x, y);
    this.offer(hit ? this.picker.ofClick(hit) : []);
  },

  pickBox() {
    const [a, b, c, d] = this.drawn, { surface, at } = this.under(a);
    this.offer(this.picker.ofBox(seenWithin(surface.triangles, at, [Math.min(a, c), Math.min(b, d), Math.max(a, c), Math.max(b, d)])));
  },
});
