// Tables of the report are sorted by the column whose head is clicked. Folded ones are printed, too.
function sortBy(head) {
  const table = head.closest("table"), index = head.cellIndex, body = table.tBodies[0];
  const up = head.getAttribute("aria-sort") !== "ascending";
  for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", up ? "ascending" : "descending");
  const key = row => {
    const cell = row.cells[index];
    return index === 0 ? cell.textContent.trim() : cell.dataset.value === "" ? Infinity : +cell.dataset.value;
  };
  const order = (a, b) => { const x = key(a), y = key(b); return x < y ? -1 : x > y ? 1 : 0; };
  body.append(...[...body.rows].sort((a, b) => up ? order(a, b) : order(b, a)));
}
for (const head of document.querySelectorAll("table:not(.inspector) thead th")) {
  head.tabIndex = 0;
  head.addEventListener("click", () => sortBy(head));
  head.addEventListener("keydown", event => { if (event.key === "Enter") sortBy(head); });
}
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach(details => { details.open = true; }));
