// The table of pairs: all pairs of several photographs, estimated one after another. A row keeps what
// it shows; a pair that is chosen is estimated again.
import { element, facts, verdict } from "./result.js";
import { estimated } from "./server.js";

const MOST = 12; // photographs, of 66 pairs
const at = (id) => document.getElementById(id);
let rows = [];
export let newest = 0; // number of the newest table; answers for older ones are ignored

/** What was dropped as files, with those below folders; no hidden ones. To be called at once. */
export function droppedFiles({ items }) {
  return Array.fromAsync(filesOf([...items].map((item) => item.webkitGetAsEntry()).filter(Boolean)));
}

async function* filesOf(entries) {
  for (const entry of entries.filter(({ name }) => !name.startsWith("."))) {
    if (entry.isFile) yield new Promise((done, failed) => entry.file(done, failed));
    const reader = entry.isDirectory && entry.createReader(); // which gives a hundred at a time
    const more = () => new Promise((done, failed) => reader.readEntries(done, failed));
    for (let some; reader && (some = await more()).length;) yield* filesOf(some);
  }
}

/** Of more than two files the photographs, the first `MOST` in the order of their names. */
export function photographsOf(files) {
  at("taken").textContent = "";
  if (files.length <= 2) return files;
  const [, ...endings] = at("file1").accept.split(",");
  const photographs = files.filter(({ name, type }) => (
    type.startsWith("image/") || endings.some((ending) => name.toLowerCase().endsWith(ending))));
  photographs.sort((a, b) => a.name.localeCompare(b.name, undefined, { numeric: true }));
  const taken = photographs.slice(0, MOST);
  at("taken").textContent = `${photographs.length} of ${files.length} files are photographs by type or name; the page uses ${taken.length}.`;
  return taken;
}

/** End the table: no further pair is estimated. Returns the number of a next one. */
export function endPairs() {
  at("pairs").hidden = true;
  return ++newest;
}

/** List the pairs of images. choose: takes both images of a row that is clicked. */
export function listPairs(images, choose) {
  rows = images.flatMap((first, n) => images.slice(n + 1).map((second) => {
    const row = Object.assign(element("tr", ""), { pair: [first, second] });
    const button = element("button", `${first.name}, ${second.name}`);
    button.prepend(...row.pair.map(({ picture }) => Object.assign(new Image(), { src: picture, alt: "" })));
    row.insertCell().append(button);
    row.addEventListener("click", () => {
      for (const other of rows) other.ariaCurrent = other === row;
      choose(row.pair);
    });
    return row;
  }));
  at("pairs").querySelector("tbody").replaceChildren(...rows);
  at("pairs").hidden = !rows.length;
}

/** Fill the table, row after row. */
export async function estimatePairs(camera) {
  const number = ++newest;
  for (const row of rows) row.replaceChildren(row.cells[0]);
  for (const [n, row] of rows.entries()) {
    at("pairs-progress").textContent = `pair ${n + 1} of ${rows.length}`;
    try {
      for await (const { result } of estimated(row.pair, camera)) {
        if (number !== newest) return;
        if (result) fill(row, result);
      }
    } catch (error) {
      if (number !== newest) return;
      row.append(Object.assign(element("td", error.message, "error"), { colSpan: 5 }));
    }
  }
  at("pairs-progress").textContent = `${rows.length} pairs, ${rows.filter((row) => row.querySelector(".good")).length} with a pose`;
}

function fill(row, { pose, reason }) {
  const { sort, title, why } = verdict(pose, reason);
  row.insertCell().append(element("b", title, sort), element("small", pose.success ? "" : why));
  const known = new Map(facts(pose)); // by the names that the columns have
  for (const { textContent: name } of [...at("pairs").querySelectorAll("th")].slice(2)) {
    Object.assign(row.insertCell(), { textContent: known.get(name) ?? "" }).dataset.name = name;
  }
}
