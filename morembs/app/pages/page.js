// The table of parts: sorting by mouse and keyboard, a filter, and the sections of those parts alone that are in it. Of
// many parts the page has no sections, and its rows are what links lead to.
(function () {
  "use strict";
  var most = 1000, table = document.getElementById("parts"), body = table.tBodies[0], wanted = "";
  var heads = Array.from(table.tHead.rows[0].cells), rows = Array.from(body.rows), more = document.getElementById("more");
  var sections = new Map(rows.map(function (row) { return [row, row.id ? null : document.getElementById("part-" + row.dataset.part)]; }));
  var texts = new Map(rows.map(function (row) { return [row, row.textContent.toLowerCase()]; }));

  function draw() {
    // A table of very many rows takes long to lay out: the first ones do until all are asked for.
    var some = rows.filter(function (row) { return texts.get(row).includes(wanted); }), listed = some.slice(0, most);
    body.replaceChildren(...listed);
    var seen = new Set(listed);
    sections.forEach(function (section, row) { if (section) section.hidden = !seen.has(row); });
    more.hidden = some.length <= most;
    more.textContent = "show all " + some.length + " parts, not the first " + most + " alone";
    document.getElementById("count").textContent = wanted ? some.length + " of " + rows.length + " parts" : "";
  }

  function key(row, column) {
    var cell = row.cells[column];
    if (!cell) return null;
    if (cell.dataset.v === undefined) return cell.textContent;
    // Unknown numbers are negative, of errors infinite: both come last.
    var v = Number(cell.dataset.v);
    return v >= 0 && isFinite(v) ? v : null;
  }

  heads.forEach(function (head, column) {
    if (!head.textContent.trim()) return;
    head.addEventListener("click", function () {
      var order = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
      heads.forEach(function (other) { other.removeAttribute("aria-sort"); });
      head.setAttribute("aria-sort", order === 1 ? "ascending" : "descending");
      var late = function (v) { return v === null || typeof v !== typeof (column < 3 ? "" : 0); };
      rows = rows.map(function (row) { return [key(row, column), row]; }).sort(function (a, b) {
        var x = a[0], y = b[0];
        if (late(x) || late(y)) return late(x) - late(y);
        return order * (x < y ? -1 : x > y ? 1 : 0);
      }).map(function (pair) { return pair[1]; });
      draw();
    });
  });

  document.getElementById("filter").addEventListener("input", function () { wanted = this.value.toLowerCase(); draw(); });
  more.addEventListener("click", function () { most = rows.length; draw(); });
  if (rows.length > most) draw();
})();
