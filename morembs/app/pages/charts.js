// Charts of morembs.base.charts, drawn as SVG from their plain values: values under the pointer, zoom by dragging, and
// the same by keys. No text of the data is ever taken as HTML.
(function () {
  "use strict";
  var LEFT = 80, RIGHT = 26, TOP = 10, BOTTOM = 40, DASHES = { dashed: "6 3", dotted: "1.5 2.5" };

  function make(name, attributes, parent, text) {
    var svg = ["svg", "g", "path", "line", "rect", "text", "circle", "title", "clipPath"].includes(name);
    var node = svg ? document.createElementNS("http:" + "//www.w3.org/2000/svg", name) : document.createElement(name);
    for (var key in attributes) node.setAttribute(key, attributes[key]);
    if (text !== undefined) node.textContent = text;
    if (parent) parent.append(node);
    return node;
  }

  function words(value) {
    if (value === null || !isFinite(value)) return "-";
    var size = Math.abs(value);
    if (size !== 0 && (size < 1e-3 || size >= 1e6)) return value.toExponential(2);
    return Number(value.toPrecision(4)).toLocaleString("en");
  }

  // A scale: place of a value, the inverse, and the values that are marked.
  function scale(low, high, log, from, to) {
    var f = log ? Math.log10 : function (v) { return v; }, g = log ? function (v) { return Math.pow(10, v); } : f;
    var a = f(low), b = f(high), ratio = (to - from) / (b - a);
    function marks() {
      var found = [], step, v;
      if (log && b - a >= 1) {
        step = Math.ceil((b - a) / 8);
        for (v = Math.ceil(a - 1e-9); v <= b + 1e-9; v += step) found.push(Math.pow(10, v));
        if (found.length < 3) [2, 5].forEach(function (m) {
          for (v = Math.floor(a); v <= b; v += 1) if (m * Math.pow(10, v) >= low && m * Math.pow(10, v) <= high) found.push(m * Math.pow(10, v));
        });
        return found;
      }
      step = Math.pow(10, Math.floor(Math.log10((high - low) / 4)));
      step *= [1, 2, 5, 10].find(function (m) { return (high - low) / (m * step) <= 6; });
      for (v = Math.ceil(low / step); v * step <= high * (1 + 1e-12); v += 1) found.push(v * step);
      return found;
    }
    return { at: function (v) { return from + ratio * (f(v) - a); }, back: function (p) { return g(a + (p - from) / ratio); }, marks: marks };
  }

  function ends(panel, axis, within) {
    var log = panel[axis + "_log"], low = Infinity, high = -Infinity;
    panel.curves.forEach(function (curve) {
      curve[axis].forEach(function (v, k) {
        var x = curve.x[k];
        if (v === null || (log && v <= 0) || (within && (x < within[0] || x > within[1]))) return;
        low = Math.min(low, v); high = Math.max(high, v);
      });
    });
    if (!(low <= high)) return log ? [1, 10] : [0, 1];
    if (axis === "x") return low < high ? [low, high] : [low, low ? 2 * low : 1];
    // Some room above and below; a constant is in the middle.
    if (log) { var r = Math.pow(high / low, .05) || 1; r = Math.max(r, 1.05); return [low / r, high * r]; }
    var room = .05 * (high - low) || Math.abs(high) || 1;
    return [low - (low === 0 ? 0 : room), high + room];
  }

  // Value of a curve at x: between its points where it is a line, of the nearest point of dots.
  function valueAt(curve, x, log) {
    var xs = curve.x, n = xs.length, f = log ? Math.log : function (v) { return v; };
    if (curve.dash === "dots") return null;
    if (!n || x < xs[0] || x > xs[n - 1]) return null;
    var low = 0, high = n - 1;
    while (high - low > 1) { var mid = (low + high) >> 1; if (xs[mid] <= x) low = mid; else high = mid; }
    var a = curve.y[low], b = curve.y[high];
    if (a === null || b === null) return a === null ? b : a;
    if (xs[high] === xs[low]) return b;
    return a + (b - a) * (f(x) - f(xs[low])) / (f(xs[high]) - f(xs[low]));
  }

  function drawCurves(place, chart, panel, state) {
    var height = chart.panels.length > 1 ? 240 : 330, WIDTH = state.width;
    var svg = make("svg", { viewBox: "0 0 " + WIDTH + " " + height, role: "img", tabindex: "0",
      "aria-label": chart.title + ": " + panel.y_label + " over " + panel.x_label + ". Arrow keys read values, plus and minus zoom, Escape shows all." }, place);
    var output = make("output", { "class": "soft" }, place, "\u00a0");
    var x, y, cursor = null;

    function draw() {
      svg.replaceChildren();
      var xs = state.x || state.whole, ys = ends(panel, "y", xs);
      x = scale(xs[0], xs[1], panel.x_log, LEFT, WIDTH - RIGHT);
      y = scale(ys[0], ys[1], panel.y_log, height - BOTTOM, TOP);
      var clip = "clip" + Math.random().toString(36).slice(2);
      make("rect", { x: LEFT, y: TOP, width: WIDTH - LEFT - RIGHT, height: height - TOP - BOTTOM }, make("clipPath", { id: clip }, svg));
      var last = -Infinity;
      x.marks().sort(function (a, b) { return a - b; }).forEach(function (v) {
        make("line", { "class": "grid", x1: x.at(v), x2: x.at(v), y1: TOP, y2: height - BOTTOM }, svg);
        // Numbers do not run into each other.
        if (x.at(v) - last < 58) return;
        last = x.at(v);
        make("text", { x: x.at(v), y: height - BOTTOM + 16, "text-anchor": "middle" }, svg, words(v).replace(".00e", "e"));
      });
      y.marks().forEach(function (v) {
        make("line", { "class": "grid", x1: LEFT, x2: WIDTH - RIGHT, y1: y.at(v), y2: y.at(v) }, svg);
        make("text", { x: LEFT - 6, y: y.at(v) + 4, "text-anchor": "end" }, svg, words(v).replace(".00e", "e"));
      });
      make("text", { x: (LEFT + WIDTH - RIGHT) / 2, y: height - 5, "text-anchor": "middle" }, svg, panel.x_label);
      make("text", { transform: "translate(12 " + (height - BOTTOM + TOP) / 2 + ") rotate(-90)", "text-anchor": "middle" }, svg, panel.y_label);
      var lines = make("g", { "clip-path": "url(#" + clip + ")" }, svg);
      panel.curves.forEach(function (curve) {
        var path = "", pen = false, dots = curve.dash === "dots";
        curve.x.forEach(function (v, k) {
          var w = curve.y[k];
          if (w === null || (panel.y_log && w <= 0) || (panel.x_log && v <= 0)) { pen = false; return; }
          if (dots) { make("circle", { "class": "c" + tone(curve) + " dot", cx: x.at(v), cy: y.at(w), r: 2 }, lines); return; }
          path += (pen ? "L" : "M") + x.at(v).toFixed(1) + " " + y.at(w).toFixed(1);
          pen = true;
        });
        if (path) make("path", { "class": "c" + tone(curve), d: path, "stroke-dasharray": DASHES[curve.dash] || "" }, lines);
      });
      state.line = null;
      cursor = make("line", { "class": "cursor", y1: TOP, y2: height - BOTTOM, visibility: "hidden" }, svg);
    }

    function read(at) {
      var xs = state.x || state.whole;
      at = Math.min(Math.max(at, xs[0]), xs[1]);
      state.at = at;
      cursor.setAttribute("x1", x.at(at)); cursor.setAttribute("x2", x.at(at)); cursor.setAttribute("visibility", "visible");
      var parts = panel.curves.map(function (curve) {
        var v = valueAt(curve, at, panel.x_log);
        return v === null ? "" : curve.name + " " + words(v);
      }).filter(Boolean);
      output.textContent = words(at) + ": " + parts.join(", ");
    }

    function pointed(event) {
      var box = svg.getBoundingClientRect();
      return x.back(Math.min(Math.max((event.clientX - box.left) * WIDTH / box.width, LEFT), WIDTH - RIGHT));
    }

    var from = null, band = null;
    svg.addEventListener("pointermove", function (event) {
      var at = pointed(event);
      state.panels.forEach(function (each) { each.read(at); });
      if (from === null) return;
      if (!band) band = make("rect", { "class": "band", y: TOP, height: height - TOP - BOTTOM }, svg);
      band.setAttribute("x", Math.min(x.at(from), x.at(at))); band.setAttribute("width", Math.abs(x.at(at) - x.at(from)));
    });
    svg.addEventListener("pointerdown", function (event) {
      if (event.button) return;
      from = pointed(event);
      try { svg.setPointerCapture(event.pointerId); } catch (error) { /* the pointer has gone */ }
    });
    svg.addEventListener("pointerup", function (event) {
      var to = pointed(event);
      if (from !== null && Math.abs(x.at(to) - x.at(from)) > 8) zoom([Math.min(from, to), Math.max(from, to)]);
      from = null; if (band) band.remove(); band = null;
    });
    svg.addEventListener("pointercancel", function () { from = null; if (band) band.remove(); band = null; });
    svg.addEventListener("dblclick", function () { zoom(null); });
    svg.addEventListener("keydown", function (event) {
      var xs = state.x || state.whole, wide = x.at(xs[1]) - x.at(xs[0]);
      var at = state.at === undefined ? x.back((x.at(xs[0]) + x.at(xs[1])) / 2) : state.at, p = x.at(at);
      if (event.key === "ArrowLeft") at = x.back(p - wide / 100);
      else if (event.key === "ArrowRight") at = x.back(p + wide / 100);
      else if (event.key === "+" || event.key === "=") zoom([x.back(p - (p - x.at(xs[0])) / 2), x.back(p + (x.at(xs[1]) - p) / 2)]);
      else if (event.key === "-") zoom([x.back(p - 2 * (p - x.at(xs[0]))), x.back(p + 2 * (x.at(xs[1]) - p))]);
      else if (event.key === "Escape") zoom(null);
      else return;
      event.preventDefault();
      state.panels.forEach(function (each) { each.read(at); });
    });

    function zoom(xs) {
      if (xs) xs = [Math.max(xs[0], state.whole[0]), Math.min(xs[1], state.whole[1])];
      state.x = xs && xs[1] > xs[0] ? xs : null;
      state.panels.forEach(function (each) { each.draw(); });
      state.reset.hidden = !state.x;
    }
    state.zoom = zoom;
    state.panels.push({ draw: draw, read: read });
  }

  function tone(curve) { return curve.color === null ? "-full" : curve.color % 6; }

  function drawBars(place, chart, panel, state) {
    var WIDTH = state.width, row = 22, longest = Math.max.apply(null, panel.names.map(function (name) { return name.length; }));
    var side = Math.min(14 + 7 * longest, WIDTH / 2), height = row * panel.names.length + 26, most = Math.max.apply(null, panel.values.concat([1e-12]));
    var svg = make("svg", { viewBox: "0 0 " + WIDTH + " " + height, role: "img", "aria-label": chart.title + ": " + panel.label }, place);
    panel.names.forEach(function (name, k) {
      make("text", { x: side - 6, y: row * k + 16, "text-anchor": "end" }, svg, name);
      var long = Math.max(1, (WIDTH - side - 90) * (panel.values[k] || 0) / most);
      make("rect", { "class": "bar", x: side, y: row * k + 4, width: long, height: row - 8 }, svg);
      make("text", { x: side + long + 5, y: row * k + 16 }, svg, panel.texts[k]);
    });
    make("text", { x: side, y: height - 6 }, svg, panel.label);
  }

  // From dark to bright, as viridis.
  var RAMP = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
  function shade(value) {
    var p = Math.min(Math.max(value, 0), 1) * 4, k = Math.min(Math.floor(p), 3), r = p - k;
    return "rgb(" + RAMP[k].map(function (c, i) { return Math.round(c + r * (RAMP[k + 1][i] - c)); }).join(",") + ")";
  }

  function drawMatrix(place, chart, panel) {
    var cell = Math.min(34, 420 / Math.max(panel.rows.length, panel.columns.length)), left = 110, top = 24;
    var width = left + cell * panel.columns.length + 10, height = top + cell * panel.rows.length + 90;
    var svg = make("svg", { viewBox: "0 0 " + width + " " + height, role: "img", style: "max-width:" + width + "px",
      "aria-label": chart.title + ": " + panel.row_label + " by " + panel.column_label }, place);
    var output = make("output", { "class": "soft" }, place, "\u00a0");
    make("text", { x: left, y: 14 }, svg, panel.row_label + " down, " + panel.column_label + " across");
    panel.rows.forEach(function (name, i) {
      make("text", { x: left - 6, y: top + cell * (i + .5) + 4, "text-anchor": "end" }, svg, name);
      panel.columns.forEach(function (other, j) {
        var value = panel.values[i][j], rect = make("rect", { x: left + cell * j, y: top + cell * i, width: cell - 1, height: cell - 1,
          style: "fill:" + (value === null ? "none" : shade(value)) }, svg);
        var said = name + ", " + other + ": " + words(value);
        make("title", {}, rect, said);
        rect.addEventListener("pointerenter", function () { output.textContent = said; });
      });
    });
    panel.columns.forEach(function (name, j) {
      var at = left + cell * (j + .5) + 4, y = top + cell * panel.rows.length + 6;
      make("text", { transform: "translate(" + at + " " + y + ") rotate(-90)", "text-anchor": "end" }, svg, name);
    });
  }

  // A number in place of the x of a curve is that of the curve which has them.
  function shareX(chart) {
    var curves = chart.panels.flatMap(function (panel) { return panel.curves || []; });
    curves.forEach(function (curve) { if (typeof curve.x === "number") curve.x = curves[curve.x].x; });
  }

  function draw(figure, chart) {
    shareX(chart);
    var head = make("figcaption", {}, figure);
    make("strong", {}, head, chart.title);
    var state = { panels: [], x: null, whole: null, width: Math.min(Math.max(figure.clientWidth, 320), 1280) };
    var curves = chart.panels.filter(function (panel) { return panel.kind === "curves"; });
    if (curves.length) {
      state.reset = make("button", { type: "button", hidden: "" }, head, "show all");
      state.reset.addEventListener("click", function () { state.zoom(null); });
      var key = make("ul", { "class": "key" }, figure), seen = new Set();
      curves.forEach(function (panel) {
        panel.curves.forEach(function (curve) {
          if (seen.has(curve.name)) return;
          seen.add(curve.name);
          var item = make("li", {}, key), mark = make("svg", { viewBox: "0 0 26 8", width: 26, height: 8, "aria-hidden": "true" }, item);
          if (curve.dash === "dots") make("circle", { "class": "c" + tone(curve) + " dot", cx: 13, cy: 4, r: 3 }, mark);
          else make("path", { "class": "c" + tone(curve), d: "M0 4H26", "stroke-dasharray": DASHES[curve.dash] || "" }, mark);
          make("span", {}, item, curve.name);
        });
      });
      var low = Infinity, high = -Infinity;
      curves.forEach(function (panel) { var e = ends(panel, "x"); low = Math.min(low, e[0]); high = Math.max(high, e[1]); });
      state.whole = [low, high];
    }
    chart.panels.forEach(function (panel) {
      if (panel.kind === "curves") drawCurves(figure, chart, panel, state);
      else if (panel.kind === "bars") drawBars(figure, chart, panel, state);
      else drawMatrix(figure, chart, panel);
    });
    state.panels.forEach(function (panel) { panel.draw(); });
    if (chart.note) make("p", { "class": "soft" }, figure, chart.note);
  }

  function begin(place) {
    if (place.dataset.drawn) return;
    place.dataset.drawn = "1";
    // All have their place before the first one is drawn, which is as wide as it is.
    JSON.parse(place.querySelector("script").textContent).map(function (chart) {
      return [make("figure", { "class": "chart" }, place), chart];
    }).forEach(function (pair) { draw(pair[0], pair[1]); });
  }

  // Charts are drawn when they come near, and all that are shown before a page is printed.
  var places = Array.from(document.querySelectorAll(".charts"));
  var near = new IntersectionObserver(function (entries) {
    entries.forEach(function (entry) { if (entry.isIntersecting) { begin(entry.target); near.unobserve(entry.target); } });
  }, { rootMargin: "600px" });
  places.forEach(function (place) { near.observe(place); });
  window.addEventListener("beforeprint", function () {
    places.forEach(function (place) { if (!place.closest("[hidden]")) begin(place); });
  });
})();
