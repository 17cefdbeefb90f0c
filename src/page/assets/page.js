"use strict";
// Makes the page from its data. Text is set as text content only: what a file says is never read as HTML.

const COLORS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

function number(value) {
  if (Number.isInteger(value)) return String(value);
  const size = Math.abs(value);
  return size >= 1e6 || size < 1e-3 ? value.toExponential(3) : String(Number(value.toPrecision(4)));
}

function show(page) {
  const main = document.getElementById("page");
  main.replaceChildren(
    element("h1", {}, page.title),
    element("p", { class: "soft" }, page.description),
    element("p", { class: page.good ? "status good" : "status" }, page.ended));
  const figures = element("dl", { class: "figures" });
  for (const [name, value] of page.figures) figures.append(element("div", {}, element("dt", {}, name), element("dd", {}, value)));
  main.append(figures);
  const parts = { table, plots, pictures, movie, text };
  for (const section of page.sections) {
    const place = element("section", {}, element("h2", {}, section.heading));
    for (const note of section.notes) place.append(element("p", { class: "soft" }, note));
    main.append(place);
    for (const part of section.parts) parts[part.part](part, place);
  }
  main.append(element("footer", {}, "Written by " + page.written_by + ". Plots: uPlot, MIT licence, \u00a9 2022 Leon Sorokin."));
}

function table(part, place) {
  const body = element("tbody"), head = element("tr");
  const most = part.bars === null ? 0 : Math.max(...part.rows.map((row) => row[part.bars]));
  const ofNumbers = part.head.map((_, column) => part.rows.every((cells) => cells[column] === null || typeof cells[column] === "number"));
  const rows = part.rows.map((cells, k) => {
    const row = element("tr");
    cells.forEach((cell, column) => {
      const isNumber = typeof cell === "number";
      const made = element("td", { class: ofNumbers[column] ? "number" : String(cell).length > 60 ? "long" : "word" }, cell === null ? "\u2013" : isNumber ? number(cell) : String(cell));
      if (isNumber) made.title = cell;
      if (column === part.bars && most > 0) {
        made.classList.add("bar");
        made.style.background = `linear-gradient(to right, var(--bar) ${100 * cell / most}%, transparent 0)`;
      }
      row.append(made);
    });
    const link = part.links[k];
    if (link) row.lastChild.replaceChildren(element("a", { href: link.split("/").map(encodeURIComponent).join("/") }, "page"));
    return { cells, row };
  });
  part.head.forEach((name, column) => {
    const button = element("button", { type: "button", title: "sort" }, name), cell = element("th", { scope: "col" }, button);
    button.onclick = () => {
      const sign = cell.getAttribute("aria-sort") === "ascending" ? -1 : 1;
      for (const other of head.children) other.removeAttribute("aria-sort");
      cell.setAttribute("aria-sort", sign > 0 ? "ascending" : "descending");
      rows.sort((a, b) => order(a.cells[column], b.cells[column], sign));
      body.replaceChildren(...rows.map((one) => one.row));
    };
    head.append(cell);
  });
  body.append(...rows.map((one) => one.row));
  place.append(element("div", { class: "scroll" }, element("table", { class: part.head.length === 2 ? "pairs" : "wide" }, element("thead", {}, head), body)));
}

// Nothing comes last either way.
function order(a, b, sign) {
  if (a === null || b === null) return (a === null) - (b === null);
  return sign * (typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), "en", { numeric: true }));
}

function plots(part, place) {
  const grid = element("div", { class: "plots" });
  place.append(grid);
  for (const plot of part.plots) {
    const card = element("div", { class: "plot" }, element("h3", {}, plot.title));
    grid.append(card);
    draw(plot, card);
  }
}

function draw(plot, card) {
  const style = getComputedStyle(document.documentElement), ink = () => style.getPropertyValue("--soft").trim();
  const tables = plot.curves.map((curves) => [curves.x, ...curves.columns]);
  const data = tables.length > 1 ? uPlot.join(tables, tables.map((t) => t.map(() => 1))) : tables[0];
  let count = 0;
  const series = plot.curves.flatMap((curves) => curves.labels.map((label) => {
    const color = curves.dots ? ink() : COLORS[count++ % COLORS.length];
    const spot = { show: curves.dots || curves.notes.length > 0, size: curves.notes.length ? 8 : 5, stroke: color, fill: curves.notes.length ? color : "transparent" };
    const value = (_, v) => v == null ? "\u2013" : number(v);
    return { label, stroke: color, width: curves.dots ? 0 : 1.6, points: spot, value, paths: curves.dots ? () => null : undefined };
  }));
  const axis = (label) => ({ label, stroke: ink, grid: { stroke: "#8884", width: 1 }, ticks: { stroke: "#8886" }, labelSize: 24,
    font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif" });
  const computed = plot.curves.filter((c) => !c.dots).flatMap((c) => c.x);
  const range = plot.log ? undefined : () => [computed.reduce((a, b) => Math.min(a, b), Infinity), computed.reduce((a, b) => Math.max(a, b), -Infinity)];
  // A logarithmic axis begins at a whole multiple of a power of ten: from between two of them its marks may never end.
  const whole = (v) => { const power = 10 ** Math.floor(Math.log10(v)); return Number((Math.max(1, Math.floor(v / power)) * power).toPrecision(1)); };
  const wide = (_, low, high) => low > 0 ? [whole(low / 1.6), high * 1.6] : [0.1, 1];
  const values = (_, ticks) => ticks.map((v) => v === null ? null : number(v));
  const options = {
    width: card.clientWidth - 20, height: 260, series: [{ label: plot.x, value: (_, v) => v == null ? "\u2013" : number(v) }, ...series],
    axes: [{ ...axis(plot.x), values: plot.log ? values : undefined }, { ...axis(plot.y), size: 64, values }],
    scales: plot.log ? { x: { time: false, distr: 3, range: wide }, y: { distr: 3, range: wide } } : { x: { time: false, range } },
    hooks: { draw: [(u) => notes(u, plot, data, ink())] },
  };
  const made = new uPlot(options, data, card);
  new ResizeObserver(() => made.setSize({ width: card.clientWidth - 20, height: 260 })).observe(card);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => made.redraw());
}

// Beside each point, where there is room: a note that would run into another is left out.
function notes(u, plot, data, ink) {
  const high = 11 * devicePixelRatio, taken = [];
  u.ctx.save();
  u.ctx.font = high + "px system-ui, sans-serif";
  u.ctx.fillStyle = ink;
  plot.curves.forEach((curves) => curves.notes.forEach((note, k) => {
    const x = u.valToPos(curves.x[k], "x", true) + 7 * devicePixelRatio, wide = u.ctx.measureText(note).width;
    const y = u.valToPos(curves.columns[0][k], "y", true) - 6 * devicePixelRatio;
    if (taken.some((other) => x < other.x + other.wide && other.x < x + wide && Math.abs(y - other.y) < high)) return;
    taken.push({ x, y, wide });
    u.ctx.fillText(note, x, y);
  }));
  u.ctx.restore();
}

function pictures(part, place) {
  const grid = element("div", { class: "pictures" });
  for (const picture of part.pictures) {
    const image = element("img", { src: "data:image/png;base64," + picture.png, alt: picture.name, loading: "lazy" });
    grid.append(element("figure", {}, image, element("figcaption", {}, picture.name)));
  }
  place.append(grid);
}

function text(part, place) {
  place.append(element("details", {}, element("summary", {}, part.summary), element("pre", {}, part.text)));
}

async function movie({ movie }, place) {
  const flat = movie.dimension === 2;
  const canvas = element("canvas", { class: flat ? "flow" : "flow turns", role: "img", "aria-label": "particles" });
  const play = element("button", { type: "button" }, "Play"), time = element("output");
  const slider = element("input", { type: "range", min: 0, max: movie.times.length - 1, value: 0, "aria-label": "time" });
  const color = element("select", { "aria-label": "colour" }, ...movie.colors.map((c, k) => element("option", { value: k }, c.name)));
  const pace = element("select", { "aria-label": "pace" }, ...[0.05, 0.1, 0.25, 0.5, 1].map((p) => element("option", { value: p }, p + "\u00d7 real time")));
  const bar = element("canvas", { width: 256, height: 1 }), low = element("span"), high = element("span");
  const player = element("div", { class: "player" }, canvas,
    element("div", { class: "controls" }, play, slider, time, color, pace),
    element("div", { class: "scale" }, low, bar, high),
    element("p", { class: "soft" }, movie.note + (flat ? "" : " Drag to turn.")));
  place.append(player);
  if (typeof DecompressionStream === "undefined") {
    player.replaceChildren(element("p", {}, "This browser is too old to unpack the film of the particles."));
    return;
  }
  const shown = new Player(movie, await unpack(movie), canvas);
  const update = () => {
    time.textContent = "t = " + movie.times[shown.index].toFixed(4) + " s";
    slider.value = shown.index;
    shown.draw();
  };
  const legend = () => {
    const c = movie.colors[shown.color], rgb = bytesOf(c.palette), context = bar.getContext("2d"), image = context.createImageData(256, 1);
    for (let k = 0; k < 256; k++) image.data.set([rgb[3 * k], rgb[3 * k + 1], rgb[3 * k + 2], 255], 4 * k);
    context.putImageData(image, 0, 0);
    low.textContent = number(c.low);
    high.textContent = number(c.high) + " " + c.unit;
  };
  const first = movie.times[0], span = movie.times[movie.times.length - 1] - first;
  // So that the film takes some five seconds or more.
  pace.value = [1, 0.5, 0.25, 0.1].find((p) => span / p >= 5) || 0.05;
  let playing = false, last = 0, at = first;
  const frame = (now) => {
    if (!playing) return;
    at += pace.value * (now - last) / 1000;
    last = now;
    if (at > first + span) at = first;
    let index = movie.times.findIndex((t) => t > at);
    index = (index < 0 ? movie.times.length : index) - 1;
    if (index !== shown.index) {
      shown.index = Math.max(0, index);
      update();
    }
    requestAnimationFrame(frame);
  };
  play.onclick = () => {
    playing = !playing;
    play.textContent = playing ? "Pause" : "Play";
    last = performance.now();
    at = movie.times[shown.index];
    requestAnimationFrame(frame);
  };
  slider.oninput = () => {
    shown.index = Number(slider.value);
    at = movie.times[shown.index];
    update();
  };
  color.onchange = () => {
    shown.color = Number(color.value);
    legend();
    shown.draw();
  };
  if (!flat) {
    let held = null;
    canvas.onpointerdown = (event) => {
      held = [event.clientX, event.clientY];
      canvas.setPointerCapture(event.pointerId);
    };
    canvas.onpointermove = (event) => {
      if (!held) return;
      shown.yaw -= 0.008 * (event.clientX - held[0]);
      shown.pitch = Math.max(-1.5, Math.min(1.5, shown.pitch + 0.008 * (event.clientY - held[1])));
      held = [event.clientX, event.clientY];
      shown.draw();
    };
    canvas.onpointerup = canvas.onpointercancel = () => { held = null; };
  }
  legend();
  shown.resize();
  let width = canvas.clientWidth;
  new ResizeObserver(() => {
    if (canvas.clientWidth === width) return;
    width = canvas.clientWidth;
    shown.resize();
  }).observe(player);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => shown.draw());
  update();
  document.documentElement.dataset.player = "ready";
}
