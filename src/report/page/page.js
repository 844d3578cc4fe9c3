"use strict";
// Hides rows, and sections all of whose rows are hidden, that the field or the boxes of a filter leave out.
document.documentElement.classList.add("scripted");
for (const form of document.querySelectorAll("form.filter")) {
  const field = form.querySelector("input[type=search]");
  const boxes = [...form.querySelectorAll("input[type=checkbox]")];
  const rows = [...document.querySelectorAll("table.filtered tr[data-verdict]")];
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
    form.querySelector("output").textContent = shown === rows.length ? `${shown} rows` : `${shown} of ${rows.length} rows`;
  };
  form.addEventListener("input", apply);
  form.addEventListener("submit", (event) => event.preventDefault());
  apply();
}
