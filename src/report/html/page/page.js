"use strict";
// Draws the page from its description, by functions that create elements, so that no text is read as markup.
// This is the namespace of SVG elements; its address is not written here, so that a search finds no address in a page.
const SVG = new DOMParser().parseFromString("<svg></svg>", "text/html").querySelector("svg").namespaceURI;

// Returns an element with attributes and children; text is escaped by construction.
function build(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}
const html = (name, attributes = {}, ...children) => build(document.createElement(name), attributes, children);
const svg = (name, attributes = {}, ...children) => build(document.createElementNS(SVG, name), attributes, children);
const pixels = (...parts) => parts.map((part) => (typeof part === "number" ? part.toFixed(1) : part)).join(" ");
const path = (name, ...parts) => svg("path", { class: name, d: pixels(...parts) });
const text = (name, x, y, words, anchor = "start") =>
  svg("text", { class: name, x: pixels(x), y: pixels(y), "text-anchor": anchor }, words);
const bar = (name, x, y, width, height) =>
  svg("rect", { class: name, x: pixels(x), y: pixels(y), width: Math.max(width, 0).toFixed(2), height: pixels(Math.max(height, 0)) });
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const finiteOrZero = (value) => Math.max(value ?? 0, 0);

// Charts: a number that is null is infinite or unknown, and drawn at the end of its axis.

// Returns a group with a tooltip of these words.
function withTip(words, ...children) {
  const point = svg("g", { class: "point", role: "img", "aria-label": words, tabindex: 0 }, ...children);
  for (const begins of ["pointerenter", "focus"]) point.addEventListener(begins, () => showTip(point, words));
  for (const ends of ["pointerleave", "blur"]) point.addEventListener(ends, () => { tip.hidden = true; });
  return point;
}
const tip = html("div", { class: "tip", hidden: "" });
function showTip(point, words) {
  tip.textContent = words;
  document.body.append(tip);
  tip.hidden = false;
  const at = (point.querySelector(".mark, rect") || point).getBoundingClientRect();
  const left = Math.min(at.right + 8, innerWidth - tip.offsetWidth - 8);
  const below = at.bottom + 8 + tip.offsetHeight <= innerHeight;
  tip.style.left = `${Math.max(left, 8)}px`;
  tip.style.top = `${below ? at.bottom + 8 : Math.max(at.top - 8 - tip.offsetHeight, 8)}px`;
}

// Returns round numbers between `low` and `high` with their labels: about six.
function evenTicks(low, high) {
  const rough = (high - low) / 6;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= rough) ?? 10 * power;
  const digits = clamp(-Math.floor(Math.log10(step)), 0, 100);
  const ticks = [];
  for (let i = Math.ceil(low / step); i <= Math.floor(high / step); i += 1) ticks.push([i * step, (i * step).toFixed(digits)]);
  return ticks;
}

// Linear axis with round ticks.
const evenAxis = (low, high) => ({
  place: (value) => (value - low) / (high - low),
  ticks: () => evenTicks(low, high),
});

// Logarithmic axis of errors or arguments, with ticks at powers of ten.
function decadeAxis(low, high) {
  const [from, to] = [Math.log10(low), Math.log10(high)];
  const step = Math.max(Math.ceil((to - from) / 6), 1);
  const powers = [];
  for (let i = Math.ceil(from / step); i <= Math.floor(to / step); i += 1) powers.push(i * step);
  return {
    place: (value) => (Math.log10(value) - from) / (to - from),
    ticks: () => powers.map((power) => [10 ** power, `1e${power}`]),
  };
}

// Logarithmic axis around measured values, given as [value, low, high]; values of at most 0 are drawn at its foot.
function logAxis(all) {
  const isUsable = (value) => value !== null && value > 0;
  const values = all.map(([value]) => value);
  const least = Math.min(...values.filter(isUsable));
  const hasZero = values.some((value) => value !== null && value <= 0);
  let [low, high] = [-1, 0];
  if (Number.isFinite(least)) {
    // Intervals extend the axis, downwards to a quarter of the smallest value.
    const lows = all.filter(([value]) => isUsable(value)).map(([, end]) => Math.max(end, least / 4));
    const highs = all.map(([, , end]) => end);
    low = Math.log10(Math.min(...[...lows, ...values].filter(isUsable)));
    high = Math.log10(Math.max(least, ...[...highs, ...values].filter(isUsable)));
    // It spans at least a factor of 4, and has room at both ends, more of it above a foot that stands for 0.
    const lacking = Math.max(Math.log10(2) - 0.5 * (high - low), 0);
    [low, high] = [low - lacking, high + lacking];
    const span = high - low;
    [low, high] = [low - (hasZero ? 0.15 : 0.05) * span, high + 0.05 * span];
  }
  const place = (value) => (value === null ? 1 : clamp((Math.log10(Math.max(value, 0)) - low) / (high - low), 0, 1));
  // Returns multiples of powers of ten whose exponent is a multiple of `step`.
  const multiples = (factors, step) => {
    const ticks = [];
    for (let power = Math.floor(low); power <= Math.ceil(high); power += 1) {
      if (power % step !== 0) continue;
      for (const factor of factors) {
        const value = Number(`${factor}e${power}`);
        const name = power > 5 || power < -4 ? `${factor}e${power}` : value.toFixed(Math.max(-power, 0));
        if (Math.log10(value) >= low && Math.log10(value) <= high) ticks.push([value, name]);
      }
    }
    return ticks;
  };
  // Chooses linear steps within a decade, otherwise 1, 2 and 5 times powers of ten, otherwise powers alone.
  const roundNumbers = (most) => {
    if (high - low < 1) {
      const ticks = evenTicks(10 ** low, 10 ** high);
      const isShort = (value) => value >= 1e-4 && value < 1e6;
      const shorten = ([value, name]) => [value, isShort(value) ? name : value.toExponential(1).replace("e+", "e")];
      if (ticks.length <= most) return ticks.map(shorten);
    }
    const ticks = multiples([1, 2, 5], 1);
    if (ticks.length >= 2 && ticks.length <= most) return ticks;
    const powers = multiples([1], Math.max(Math.ceil((high - low) / most), 1));
    return powers.length > 0 ? powers : ticks;
  };
  const ticks = (most) => {
    const round = roundNumbers(Math.max(Math.floor(most), 2));
    return hasZero ? [...round.filter(([value]) => place(value) > 0.06), [0, "0"]] : round;
  };
  return { place, ticks };
}

// Approximate width of a letter of a label, in pixels.
const LETTER = 6.4;

// Frame of a chart: maps values to pixels, and draws the grid and the names of two axes.
function frame({ size: [width, height], margins: [left, below, above, beside], x, y, xTicks, yTicks }) {
  const foot = height - below;
  const right = width - beside;
  const across = (value) => left + clamp(x.place(value), 0, 1) * (right - left);
  const up = (value) => foot - clamp(y.place(value), 0, 1) * (foot - above);
  // Leave out names below the axis that would touch the one before them
  const fromLeft = [...xTicks].sort((a, b) => x.place(a[0]) - x.place(b[0]));
  let end = -Infinity;
  const named = ([value, name]) => {
    const start = across(value) - 0.5 * LETTER * name.length;
    if (start < end) return [];
    end = start + LETTER * (name.length + 1);
    return [text("", across(value), foot + 15, name, "middle")];
  };
  const grid = [
    ...fromLeft.flatMap((tick) => [path("grid", "M", across(tick[0]), above, "V", foot), ...named(tick)]),
    ...yTicks.flatMap(([value, name]) => [
      path("grid", "M", left, up(value), "H", right), text("", left - 6, up(value) + 4, name, "end")]),
  ];
  return { foot, left, right, above, across, up, grid };
}
function axisNames([width, height], { left, right, foot, above }, xLabel, yLabel) {
  const middle = 0.5 * (above + foot);
  const turned = text("label", 12, middle, yLabel, "middle");
  turned.setAttribute("transform", `rotate(-90 12 ${middle.toFixed(1)})`);
  return [text("label", 0.5 * (left + right), height - 6, xLabel, "middle"), turned];
}
const chartSvg = ([width, height], label, ...children) =>
  svg("svg", { style: `width:${width}px`, viewBox: `0 0 ${width} ${height}`, role: "group", "aria-label": label }, ...children);
const chartBox = (drawn, legend) =>
  html("div", { class: "chart" }, html("div", { class: "scroll" }, drawn),
    ...(legend.length > 0 ? [html("p", { class: "legend" }, ...legend)] : []));
const legendEntry = (name, mark) =>
  html("span", {}, svg("svg", { viewBox: "0 0 16 16", width: 16, height: 16, "aria-hidden": true }, mark), name);
const colorLegend = (colors) => colors.map(([look, name]) => legendEntry(name, bar(`bar ${colorOf(look)}`, 1, 4, 14, 8)));

// Colour and shape of a series by its number; null is the base, which is drawn as a ring. No two of 24 look alike.
const colorOf = (look) => (look === null ? "base" : `look${look % 6}`);
const MARK = 4.2;
function mark(look, x, y) {
  const circle = (r) => ["M", x - r, y, "a", r, r, "0 1 0", 2 * r, "0 a", r, r, "0 1 0", -2 * r, "0 z"];
  const shapes = [
    circle(MARK),
    ["M", x - 0.9 * MARK, y - 0.9 * MARK, "h", 1.8 * MARK, "v", 1.8 * MARK, "h", -1.8 * MARK, "z"],
    ["M", x, y - 1.2 * MARK, "l", 1.2 * MARK, 2.1 * MARK, "h", -2.4 * MARK, "z"],
    ["M", x, y - 1.3 * MARK, "l", 1.3 * MARK, 1.3 * MARK, "l", -1.3 * MARK, 1.3 * MARK, "l", -1.3 * MARK, -1.3 * MARK, "z"],
  ];
  const shape = look === null ? circle(1.6 * MARK) : shapes[(look + Math.floor(look / 12)) % 4];
  return path(`mark ${colorOf(look)}`, ...shape);
}

// Returns labels beside points that overlap neither points nor each other; others are left out.
function labels(points, { left, above, right, foot }) {
  const overlap = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
  const isWithin = (a) => a.left >= left && a.right <= right && a.top >= above && a.bottom <= foot;
  const taken = points.map(({ x, y }) => ({ left: x - MARK, right: x + MARK, top: y - MARK, bottom: y + MARK }));
  const drawn = [];
  for (const { x, y, label } of points.filter((point) => point.label)) {
    const width = LETTER * label.length;
    const areas = [[5, -5], [-5 - width, -5], [5, 14], [-5 - width, 14]].map(([beside, down]) =>
      ({ left: x + beside, right: x + beside + width, top: y + down - 11, bottom: y + down }));
    const free = areas.find((area) => isWithin(area) && !taken.some((other) => overlap(area, other)));
    if (!free) continue;
    drawn.push(text("level", free.left, free.bottom - 1.5, label));
    taken.push(free);
  }
  return drawn;
}

// Fades the other series of a chart while a legend entry is under the pointer.
function fadeOthers(entry, own, all) {
  entry.addEventListener("pointerenter", () => all.forEach((series) => series.classList.toggle("faded", series !== own)));
  entry.addEventListener("pointerleave", () => all.forEach((series) => series.classList.remove("faded")));
}

const pointsOf = (chart) => chart.series.flatMap((series) => series.points);
const axesAround = (points) => [logAxis(points.map(({ x }) => x)), logAxis(points.map(({ y }) => y))];

const charts = {
  // Points with intervals over two logarithmic axes.
  scatter(chart, [x, y] = axesAround(pointsOf(chart))) {
    const { size } = chart;
    const area = frame({
      size, margins: [62, 44, 12, 16], x, y, xTicks: x.ticks((size[0] - 78) / 46), yTicks: y.ticks((size[1] - 56) / 24),
    });
    const { across, up } = area;
    const lines = chart.lines.filter(({ corners }) => corners.length > 0).map(({ class: name, look, corners }) =>
      path(`${name} ${colorOf(look)}`, ...corners.flatMap((corner, i) => [i === 0 ? "M" : "L", across(corner[0]), up(corner[1])])));
    const drawPoint = (look, { x: [x, left, right], y: [y, low, high], words }) => withTip(words,
      path(`interval ${colorOf(look)}`, "M", across(left), up(y), "H", across(right), "M", across(x), up(low), "V", up(high)),
      mark(look, across(x), up(y)));
    const groups = chart.series.map(({ look, points }) =>
      svg("g", { class: "series" }, ...points.map((point) => drawPoint(look, point))));
    const placed = pointsOf(chart).map((point) => ({ x: across(point.x[0]), y: up(point.y[0]), label: point.label }));
    const legend = chart.series.length < 2 ? [] : chart.series.map(({ name, look }, number) => {
      const entry = legendEntry(name, mark(look, 8, 8));
      entry.dataset.series = number;
      fadeOthers(entry, groups[number], groups);
      return entry;
    });
    const drawn = chartSvg(size, `${chart.y} over ${chart.x}`,
      ...area.grid, ...lines, ...groups, ...labels(placed, area), ...axisNames(size, area, chart.x, chart.y));
    return chartBox(drawn, legend);
  },

  // Scatter charts with captions and equal axes.
  multiples({ charts: all }) {
    const axes = axesAround(all.flatMap(([, chart]) => pointsOf(chart)));
    return html("div", { class: "pictures" }, ...all.map(([caption, chart]) =>
      html("figure", {}, charts.scatter(chart, axes), html("figcaption", {}, caption))));
  },

  // Groups of horizontal bars from 0, each with its range.
  bars({ label, groups, legend }) {
    const [width, names, behind, rowHeight] = [861, 235, 58, 16];
    const ends = groups.flatMap((group) => group.bars).flatMap(({ value: [value, , high] }) => [value, high]);
    const most = Math.max(...ends.map(finiteOrZero), 0) || 1;
    const across = (value) => names + clamp(finiteOrZero(value) / most, 0, 1) * (width - names - behind);
    const rows = [];
    let y = 4;
    for (const group of groups) {
      rows.push(text("label", 4, y + 15, group.name));
      y += 22;
      for (const { name, look, value: [value, low, high], label: behindBar, words } of group.bars) {
        const middle = y + 0.5 * rowHeight;
        rows.push(withTip(words,
          text("", names - 6, middle + 4, name, "end"),
          bar(`bar ${colorOf(look)}`, names, y + 1.5, Math.max(across(value) - names, 1), rowHeight - 3),
          path("whisker", "M", across(low), middle, "H", across(high)),
          text("level", Math.max(across(high), across(value)) + 5, middle + 4, behindBar)));
        y += rowHeight;
      }
    }
    const grid = evenTicks(0, most).flatMap(([value, name]) => [
      path("grid", "M", across(value), 4, "V", y), text("", across(value), y + 15, name, "middle")]);
    const axisName = text("label", 0.5 * (names + width - behind), y + 34, label, "middle");
    return chartBox(chartSvg([width, y + 42], label, ...grid, ...rows, axisName), colorLegend(legend));
  },

  // Stacked columns from 0, numbered from 1.
  stacks({ x_label: xLabel, y_label: yLabel, parts, stacks }) {
    const size = [861, 240];
    const height = (stack) => stack.parts.reduce((sum, part) => sum + finiteOrZero(part), 0);
    const y = evenAxis(0, stacks.reduce((most, stack) => Math.max(most, height(stack)), 0) || 1);
    const x = { place: (number) => (number - 0.5) / Math.max(stacks.length, 1) };
    // The first column and round numbers have a label.
    const step = Math.max(Math.floor(evenTicks(0, Math.max(stacks.length, 1))[1]?.[0] ?? 1), 1);
    const numbers = stacks.map((_, i) => i + 1).filter((number) => number === 1 || number % step === 0);
    const area = frame({
      size, margins: [52, 42, 14, 14], x, y, xTicks: [], yTicks: y.ticks(),
    });
    const { across, up, foot } = area;
    const width = Math.min(0.85 * (area.right - area.left) / Math.max(stacks.length, 1), 24);
    const columns = stacks.map((stack, i) => {
      const left = across(i + 1) - 0.5 * width;
      let below = 0;
      const drawn = stack.parts.map((part, k) => {
        const above = below + finiteOrZero(part);
        const rect = bar(`bar ${colorOf(parts[k][0])}`, left, up(above), width, up(below) - up(above));
        below = above;
        return rect;
      });
      if (stack.is_wrong) drawn.push(bar("failed", left, foot - 7, width, 7));
      return withTip(stack.words, ...drawn);
    });
    const columnNumbers = numbers.map((number) => text("", across(number), foot + 15, number, "middle"));
    const drawn = chartSvg(size, `${yLabel} over ${xLabel}`,
      ...area.grid, ...columnNumbers, ...columns, ...axisNames(size, area, xLabel, yLabel));
    return chartBox(drawn, colorLegend(parts));
  },

  // Bars from the smallest to the largest ratio of each change, on a binary logarithmic axis; the longest is at the top.
  tornado({ label, rows }) {
    const [width, names, margin, barHeight, most] = [820, 110, 92, 13, 40];
    const power = (ratio) => (ratio === null ? most : clamp(Math.log2(ratio), -most, most));
    const powers = (bar) => bar.ends.map(({ ratio }) => power(ratio));
    const longest = (row) => Math.max(...row.bars.map((bar) => powers(bar)[1] - powers(bar)[0]), 0);
    // A ratio of 0 must not extend the axis to the largest power.
    const shown = rows.flatMap((row) => row.bars.flatMap(powers)).filter((power) => Math.abs(power) < most);
    const [low, high] = [Math.floor(Math.min(-1, ...shown)), Math.ceil(Math.max(1, ...shown))];
    const across = (power) => names + margin + clamp((power - low) / (high - low), 0, 1) * (width - names - 2 * margin);
    const shorten = (level) => (level.length <= 13 ? level : `${level.slice(0, 12).trimEnd()}…`);
    const drawn = [];
    let y = 8;
    for (const row of [...rows].sort((a, b) => longest(b) - longest(a))) {
      y += 6;
      const bars = row.bars.flatMap((each, number) => {
        const [left, right] = powers(each).map(across);
        const top = y + number * barHeight;
        return [
          bar(each.class, left, top + 1, Math.max(right - left, 1), barHeight - 2),
          text("level", left - 4, top + barHeight - 3, shorten(each.ends[0].level), "end"),
          text("level", right + 4, top + barHeight - 3, shorten(each.ends[1].level)),
        ];
      });
      drawn.push(withTip(row.words, text("label", 4, y + 0.5 * barHeight * row.bars.length + 4, row.name), ...bars));
      y += row.bars.length * barHeight + 6;
    }
    const step = Math.max(Math.ceil((high - low) / 9), 1);
    const grid = [];
    for (let power = Math.ceil(low / step) * step; power <= high; power += step) {
      const name = power < 0 ? `x1/${2 ** -power}` : `x${2 ** power}`;
      grid.push(path(power === 0 ? "zero" : "grid", "M", across(power), 8, "V", y), text("", across(power), y + 15, name, "middle"));
    }
    const axisName = text("label", across(0.5 * (low + high)), y + 34, label, "middle");
    const legend = (rows[0]?.bars ?? []).map((each) => legendEntry(each.class, bar(each.class, 1, 4, 14, 8)));
    return chartBox(chartSvg([width, y + 42], label, ...grid, ...drawn, axisName), legend);
  },

  // Errors over arguments with a limit; an axis is logarithmic where values span decades or are far below the limit.
  plot({ x_label: xLabel, y_label: yLabel, limit, marks }) {
    const size = [560, 260];
    const places = marks.map(({ x }) => x);
    const [low, high] = places.reduce(([low, high], x) => [Math.min(low, x), Math.max(high, x)], [Infinity, -Infinity]);
    const middle = Number.isFinite(low) ? low : 0;
    const x = low > 0 && high > 100 * low ? decadeAxis(low, high)
      : low < high ? evenAxis(low, high) : evenAxis(middle - 1, middle + 1);
    const highest = marks.reduce((most, { y }) => Math.max(most, y ?? Infinity), 0);
    // Errors below 1/4096 of the largest are drawn at the foot, and those above 4 times the limit at the top.
    const y = highest > 0 && highest < limit / 32 ? decadeAxis(highest / 4096, 2 * limit)
      : evenAxis(0, 1.1 * clamp(highest, limit, 4 * limit));
    const area = frame({ size, margins: [52, 42, 14, 14], x, y, xTicks: x.ticks(), yTicks: y.ticks() });
    const { across, up, left, right } = area;
    const dots = marks.map(({ x, y, class: name }) =>
      svg("circle", { class: name, cx: pixels(across(x)), cy: pixels(up(y ?? Infinity)), r: 2.2 }));
    return svg("svg", { class: "plot", viewBox: `0 0 ${size.join(" ")}`, role: "img", "aria-label": `${yLabel} over ${xLabel}` },
      ...area.grid, path("limit", "M", left, up(limit), "H", right), text("limit", right, up(limit) - 4, "bound", "end"),
      ...dots, ...axisNames(size, area, xLabel, yLabel));
  },
};

// Elements of the page, by the kind in their descriptions.
const drawAll = (descriptions) => descriptions.map((description) => elements[description.kind](description));
const cell = ({ text, range = "", badge = "", to = "", layout = "" }) => {
  const parts = range ? [`${text} `, html("span", { class: "faint" }, range)] : [text];
  const name = badge ? `badge ${badge}` : "";
  if (to) return html("a", { class: name, href: `#${to}` }, ...parts);
  if (layout === "short") return html("span", { class: layout, title: text }, ...parts);
  return badge ? html("span", { class: name }, ...parts) : html("span", {}, ...parts);
};
const image = ({ width, height, words, png }) =>
  html("img", { width, height, alt: words, src: `data:image/png;base64,${png}` });
const checkbox = (attributes, ...words) => html("label", {}, html("input", { type: "checkbox", ...attributes }), " ", ...words);

const elements = {
  ...charts,
  heading: ({ level, text, id }) => html(`h${level}`, id ? { id } : {}, text),
  paragraph: ({ parts }) => html("p", {}, ...parts.map(cell)),
  note: ({ text }) => html("p", { class: "faint" }, text),
  facts: ({ pairs }) => html("dl", { class: "facts" }, ...pairs.flatMap(([name, value]) => [html("dt", {}, name), html("dd", {}, value)])),
  numbers: ({ tiles }) => html("div", { class: "tiles" }, ...tiles.map(([number, word, name]) =>
    html("div", { class: `tile ${name}` }, html("b", {}, number), html("span", {}, word)))),
  alert: ({ title, items, text }) => html("div", { class: "stamp", role: "alert" },
    html("b", {}, title), html("ul", {}, ...items.map((item) => html("li", {}, item))), html("p", {}, text)),
  preformatted: ({ text }) => html("pre", {}, text),
  key: ({ colors }) => html("p", { class: "key" }, "Colours: ", ...colors.flatMap(([name, word]) => [html("i", { class: name }), word, " "])),
  filter: ({ verdicts }) => html("form", { class: "filter", role: "search" },
    html("input", { type: "search", placeholder: "Filter by name, path or words", "aria-label": "Filter" }),
    ...verdicts.map(([name, word]) => checkbox({ value: name, checked: "" }, html("span", { class: `badge ${name}` }, word))),
    html("output")),
  section: ({ id, elements: own }) => html("section", { id, "data-item": id }, ...drawAll(own)),
  side_by_side: ({ class: name, elements: own }) => html("div", { class: name }, ...drawAll(own)),
  figure: ({ elements: own, caption }) => html("figure", {}, ...drawAll(own), html("figcaption", {}, caption)),
  image,
  table({ class: name, columns, rows }) {
    const align = (i) => (columns[i][1] ? { class: "number" } : {});
    const head = columns.map(([heading], i) => html("th", { scope: "col", ...align(i) }, heading));
    const drawCell = (each, i) => html("td", each.layout === "wrap" ? { class: "wrap" } : align(i), cell(each));
    const body = rows.map(({ verdict, item, cells }) =>
      html("tr", { "data-verdict": verdict, "data-item": item }, ...cells.map(drawCell)));
    return html("div", { class: "scroll" },
      html("table", { class: name }, html("thead", {}, html("tr", {}, ...head)), html("tbody", {}, ...body)));
  },
  drawing({ size, words, lines, dots }) {
    const paths = Object.entries(lines).map(([name, d]) => svg("path", { class: name, d }));
    const circles = dots.map(([name, x, y]) => svg("circle", { class: name, cx: x, cy: y, r: 2.6 }));
    return svg("svg", { viewBox: `0 0 ${size} ${size}`, width: size, height: size, role: "img", "aria-label": words }, ...paths, ...circles);
  },
  viewer({ views }) {
    const modes = [["slide", "slide"], ["turns", "in turns"], ...views.map(([name]) => [name, name])];
    const buttons = modes.map(([value, word], i) =>
      html("label", {}, html("input", { type: "radio", name: "view", value, ...(i === 0 ? { checked: "" } : {}) }), ` ${word}`));
    const cut = html("input", { type: "range", name: "cut", min: 0, max: 100, step: 0.1, value: 50, "aria-label": "Boundary between the images" });
    const figures = views.map(([name, shown]) =>
      html("figure", { "data-view": name }, image(shown), html("figcaption", {}, shown.words)));
    return html("div", { class: "viewer" },
      html("form", {}, ...buttons, checkbox({ name: "pixels" }, "pixel by pixel"), cut), html("div", { class: "stage" }, ...figures));
  },
  gallery({ cards }) {
    const option = ([value, word]) => html("option", { value }, word);
    const choices = [["number", "by number"], ["name", "by name"], ["time", "longest first"], ["status", "failed first"]];
    const order = html("form", { class: "order" },
      html("label", {}, "Order ", html("select", { "aria-label": "Order" }, ...choices.map(option))),
      html("span", { class: "faint" }, "Arrow keys move between frames, Enter opens a frame, / starts a search."));
    return html("div", {}, order, html("div", { class: "gallery" }, ...cards.map(card)));
  },
};

// Frame of a batch: thumbnail, name, status, shares of effects and details.
function card({ name, status: [verdict, word], address, png, seconds, message, shares, shares_words: sharesWords, words }, number) {
  const link = (attributes, shown) => (address ? html("a", { tabindex: -1, href: address, ...attributes }, shown) : shown);
  const thumbnail = png
    ? html("img", { loading: "lazy", decoding: "async", alt: name, src: `data:image/png;base64,${png}` })
    : html("div", { class: "nothing" }, address ? "no thumbnail" : word);
  const share = ({ look, part, words }) => html("i", { class: colorOf(look), style: `width:${(100 * part).toFixed(2)}%`, title: words });
  return html("article",
    { class: `frame ${verdict}`, "data-verdict": verdict, "data-number": number, "data-name": name, "data-seconds": seconds, tabindex: 0 },
    link({ class: "open" }, thumbnail),
    html("h3", {}, link({}, name), " ", html("span", { class: `badge ${verdict}` }, word)),
    ...(message ? [html("p", { class: "message" }, message)] : []),
    ...(shares.length > 0 ? [html("div", { class: "share", role: "img", "aria-label": sharesWords }, ...shares.map(share))] : []),
    html("p", {}, words));
}

const description = JSON.parse(document.getElementById("description").textContent);
document.querySelector("main").append(html("h1", {}, description.heading), ...drawAll(description.elements));

// Filter: hides rows that do not match the search field or the checkboxes, and sections without a visible row.
for (const form of document.querySelectorAll("form.filter")) {
  const field = form.querySelector("input[type=search]");
  const boxes = [...form.querySelectorAll("input[type=checkbox]")];
  const rows = [...document.querySelectorAll("table.filtered tr[data-verdict], .gallery > [data-verdict]")];
  const what = document.querySelector(".gallery") ? "frames" : "rows";
  const others = [...document.querySelectorAll("section[data-item], table.overview tr[data-item]")];
  const apply = () => {
    const words = field.value.toLowerCase().split(/\s+/).filter(Boolean);
    const verdicts = new Set(boxes.filter((box) => box.checked).map((box) => box.value));
    const items = new Set();
    let shown = 0;
    for (const row of rows) {
      const text = row.textContent.toLowerCase();
      const keep = verdicts.has(row.dataset.verdict) && words.every((word) => text.includes(word));
      row.hidden = !keep;
      if (keep) {
        shown += 1;
        items.add(row.dataset.item);
      }
    }
    for (const other of others) other.hidden = !items.has(other.dataset.item);
    form.querySelector("output").textContent = shown === rows.length ? `${shown} ${what}` : `${shown} of ${rows.length} ${what}`;
  };
  form.addEventListener("input", apply);
  form.addEventListener("submit", (event) => event.preventDefault());
  apply();
}

// Viewer: shows one image, two images with a slider between them, or two in alternation.
for (const viewer of document.querySelectorAll(".viewer")) {
  const form = viewer.querySelector("form");
  const stage = viewer.querySelector(".stage");
  const figures = [...stage.querySelectorAll("figure")];
  const [under, over] = figures;
  let turn = 0;
  const apply = () => {
    const mode = form.elements.view.value;
    stage.classList.toggle("slide", mode === "slide");
    stage.classList.toggle("pixels", form.elements.pixels.checked);
    form.elements.cut.hidden = mode !== "slide";
    stage.style.setProperty("--cut", `${form.elements.cut.value}%`);
    for (const figure of figures) {
      figure.hidden = mode === "slide" ? figure !== under && figure !== over
        : mode === "turns" ? figure !== figures[turn]
        : figure.dataset.view !== mode;
    }
  };
  const slideTo = (event) => {
    const box = over.querySelector("img").getBoundingClientRect();
    form.elements.cut.value = (100 * (event.clientX - box.left)) / box.width;
    apply();
  };
  stage.addEventListener("pointermove", (event) => {
    if (event.buttons && stage.classList.contains("slide")) slideTo(event);
  });
  stage.addEventListener("click", (event) => {
    if (stage.classList.contains("slide")) return slideTo(event);
    if (form.elements.view.value === "turns") turn = 1 - turn;
    apply();
  });
  // With reduced motion, the images alternate only by clicks.
  if (!matchMedia("(prefers-reduced-motion: reduce)").matches) {
    setInterval(() => {
      if (form.elements.view.value !== "turns") return;
      turn = 1 - turn;
      apply();
    }, 600);
  }
  form.addEventListener("input", apply);
  form.addEventListener("submit", (event) => event.preventDefault());
  apply();
}

// Gallery: sorts the frames, and moves the focus between them by keys.
for (const list of document.querySelectorAll(".gallery")) {
  const order = document.querySelector("form.order");
  const select = order.querySelector("select");
  const statuses = ["fails", "measured", "holds", "skipped"];
  const number = (frame) => Number(frame.dataset.number);
  const orders = {
    number: () => 0,
    name: (a, b) => a.dataset.name.localeCompare(b.dataset.name, "en", { numeric: true }),
    time: (a, b) => b.dataset.seconds - a.dataset.seconds,
    status: (a, b) => statuses.indexOf(a.dataset.verdict) - statuses.indexOf(b.dataset.verdict),
  };
  const sort = () => list.append(...[...list.children].sort((a, b) => orders[select.value](a, b) || number(a) - number(b)));
  order.addEventListener("input", sort);
  order.addEventListener("submit", (event) => event.preventDefault());
  sort();

  // Step of each key among the visible frames, with `across` frames in a row.
  const steps = {
    ArrowRight: () => 1,
    ArrowLeft: () => -1,
    ArrowDown: (across) => across,
    ArrowUp: (across) => -across,
    Home: (_, shown, at) => -at,
    End: (_, shown, at) => shown.length - 1 - at,
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target.matches("input, select")) return;
    if (event.key === "/") {
      event.preventDefault();
      document.querySelector("form.filter input[type=search]").focus();
      return;
    }
    const shown = [...list.children].filter((frame) => !frame.hidden);
    const at = shown.indexOf(document.activeElement.closest(".frame"));
    if (event.key === "Enter" && event.target === shown[at]) shown[at].querySelector("a.open")?.click();
    const step = steps[event.key];
    // Without a focused frame, the right arrow focuses the first one, and the other keys scroll.
    if (!step || (at < 0 && event.key !== "ArrowRight")) return;
    event.preventDefault();
    const across = shown.filter((frame) => frame.offsetTop === shown[0].offsetTop).length;
    const to = at < 0 ? 0 : at + step(across, shown, at);
    if (shown[to]) shown[to].focus();
  });
}
