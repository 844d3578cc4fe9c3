"use strict";
// Filter: hides rows that do not match the search field or the checkboxes, and sections without a visible row.
document.documentElement.classList.add("scripted");
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

// Charts: shows a tooltip for the point under the pointer, and fades other series while a legend entry is hovered.
const tip = document.createElement("div");
tip.className = "tip";
tip.hidden = true;
for (const point of document.querySelectorAll(".chart .point")) {
  const title = point.querySelector("title");
  const words = title.textContent;
  title.remove();
  point.setAttribute("aria-label", words);
  point.setAttribute("tabindex", "0");
  const showTip = () => {
    tip.textContent = words;
    document.body.append(tip);
    tip.hidden = false;
    const at = (point.querySelector(".mark, rect") || point).getBoundingClientRect();
    const left = Math.min(at.right + 8, innerWidth - tip.offsetWidth - 8);
    const below = at.bottom + 8 + tip.offsetHeight <= innerHeight;
    tip.style.left = `${Math.max(left, 8)}px`;
    tip.style.top = `${below ? at.bottom + 8 : Math.max(at.top - 8 - tip.offsetHeight, 8)}px`;
  };
  for (const begins of ["pointerenter", "focus"]) point.addEventListener(begins, showTip);
  for (const ends of ["pointerleave", "blur"]) point.addEventListener(ends, () => { tip.hidden = true; });
}
for (const entry of document.querySelectorAll(".legend [data-series]")) {
  const all = [...entry.closest(".chart").querySelectorAll(".series")];
  const show = (is) => all.forEach((series) => series.classList.toggle("faded", !is(series)));
  entry.addEventListener("pointerenter", () => show((series) => series.dataset.series === entry.dataset.series));
  entry.addEventListener("pointerleave", () => show(() => true));
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
