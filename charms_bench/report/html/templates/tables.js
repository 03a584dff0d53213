// Sorts tables, shows definitions of numbers and what is cut off, and switches between light and dark.
"use strict";

function valueOf(row, column) {
  const cell = row.cells[column];
  if (cell.tagName === "TH") return cell.textContent.trim().toLowerCase();
  return "value" in cell.dataset ? Number(cell.dataset.value) : null;
}

function compare(a, b) {
  return typeof a === "string" ? a.localeCompare(b, undefined, { numeric: true }) : a - b;
}

function sortBy(button) {
  const header = button.closest("th");
  const body = header.closest("table").tBodies[0];
  const descending = header.getAttribute("aria-sort") === "ascending";
  for (const other of header.parentElement.cells) other.removeAttribute("aria-sort");
  header.setAttribute("aria-sort", descending ? "descending" : "ascending");
  const rows = [...body.rows].map((row) => [valueOf(row, header.cellIndex), row]);
  rows.sort(([a], [b]) => {
    if (a === null || b === null) return (a === null) - (b === null); // undefined values stay last
    return descending ? compare(b, a) : compare(a, b);
  });
  body.append(...rows.map(([, row]) => row));
}

for (const button of document.querySelectorAll("button.sort")) {
  button.addEventListener("click", () => sortBy(button));
}

const card = document.getElementById("card");

function explain(link) {
  const definition = document.getElementById(decodeURIComponent(link.hash.slice(1)));
  const cell = link.closest("td");
  const value = document.getElementById("card-value");
  const copy = (name, part) => {
    const nodes = definition.querySelector(part).cloneNode(true).childNodes;
    document.getElementById(name).replaceChildren(...nodes);
  };
  copy("card-name", "dt");
  copy("card-text", "dd");
  value.hidden = !cell;
  if (cell) {
    const who = [...cell.parentElement.querySelectorAll("th")].map((each) => each.textContent);
    const text = (part) => cell.querySelector(part)?.textContent.replace("◇", "").trim();
    const said = [
      text(".interval") && `95 % interval ${text(".interval")}`,
      link.dataset.n && `n = ${link.dataset.n}`,
      text(".paper") && `${text(".paper")} (ours minus theirs ${link.dataset.difference})`,
    ];
    value.textContent = [`${who.join(" in ")}: ${link.textContent}`, ...said.filter(Boolean)].join(", ");
  }
  card.showPopover();
  const at = link.getBoundingClientRect();
  const left = Math.min(at.left, window.innerWidth - card.offsetWidth - 12);
  const below = at.bottom + 8 + card.offsetHeight < window.innerHeight;
  card.style.left = `${Math.max(12, left)}px`;
  card.style.top = `${below ? at.bottom + 8 : Math.max(12, at.top - card.offsetHeight - 8)}px`;
}

if ("showPopover" in card) {
  for (const link of document.querySelectorAll("a.number, a.define")) {
    link.addEventListener("click", (event) => {
      event.preventDefault();
      explain(link);
    });
  }
  document.getElementById("card-close").addEventListener("click", () => card.hidePopover());
}

// What is cut on the right fades there, and a table says that there is more.
function showCuts() {
  for (const each of document.querySelectorAll(".scroll, .drawing, .timelines")) {
    const hidden = each.scrollWidth - each.clientWidth;
    each.classList.toggle("overflows", hidden > 2);
    each.classList.toggle("cut-right", hidden - each.scrollLeft > 2);
  }
}

document.addEventListener("scroll", showCuts, { capture: true, passive: true });
document.addEventListener("toggle", showCuts, { capture: true });
new ResizeObserver(showCuts).observe(document.body);

const theme = document.getElementById("theme");
const prefersDark = matchMedia("(prefers-color-scheme: dark)");
let isDark = prefersDark.matches;

function showTheme(chosen) {
  if (chosen) document.documentElement.dataset.theme = isDark ? "dark" : "light";
  theme.textContent = isDark ? "Light" : "Dark";
  theme.setAttribute("aria-label", `${theme.textContent} page`);
  document.dispatchEvent(new Event("themechange"));
}

theme.hidden = false;
theme.addEventListener("click", () => {
  isDark = !isDark;
  showTheme(true);
});
prefersDark.addEventListener("change", () => {
  isDark = prefersDark.matches;
  delete document.documentElement.dataset.theme;
  showTheme(false);
});
showTheme(false);

// Folded sections are printed open.
const folded = [];
window.addEventListener("beforeprint", () => {
  for (const each of document.querySelectorAll("details:not([open])")) {
    each.open = true;
    folded.push(each);
  }
});
window.addEventListener("afterprint", () => {
  for (const each of folded.splice(0)) each.open = false;
});
