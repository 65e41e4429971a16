// Sorts and filters the table of a fleet. Without it the table is there, the worst unit first.
(() => {
  "use strict";
  const table = document.getElementById("units"), body = table.tBodies[0], rows = [...body.rows], filter = document.getElementById("filter");
  const [verdict, words, said] = ["select", "input", ".said"].map((what) => filter.querySelector(what));
  const shown = () => {
    const asked = words.value.trim().toLowerCase();
    for (const row of rows) row.hidden = (verdict.value && row.dataset.verdict !== verdict.value) || !row.textContent.toLowerCase().includes(asked);
    said.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length} units`;
  };
  const key = (row, i) => {
    const cell = row.cells[i];
    return i && cell.dataset.key !== undefined ? Number(cell.dataset.key) : cell.textContent.trim().toLowerCase();
  };
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, i) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = head.textContent;
    head.replaceChildren(button);
    head.setAttribute("aria-sort", "none");
    button.addEventListener("click", () => {
      const numbers = i && rows.every((row) => row.cells[i].dataset.key !== undefined);
      const up = head.getAttribute("aria-sort") === "none" ? !numbers : head.getAttribute("aria-sort") === "descending";
      heads.forEach((other) => other.setAttribute("aria-sort", "none"));
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const order = (a, b) => (numbers ? a - b : a.localeCompare(b, undefined, { numeric: true }));
      rows.sort((a, b) => (up ? 1 : -1) * order(key(a, i), key(b, i)));
      body.append(...rows);
    });
  });
  verdict.addEventListener("change", shown);
  words.addEventListener("input", shown);
  filter.hidden = false;
})();
