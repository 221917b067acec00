// The table of pairs: all pairs of several photographs, estimated one after another. A row keeps
// only the shown facts; choosing a pair estimates it again.
import { element, facts, verdict } from "./result.js";
import { estimated } from "./server.js";

const MOST = 12; // photographs, which make 66 pairs
const at = (id) => document.getElementById(id);
let rows = [];
export let newest = 0; // number of the newest table; answers for older ones are ignored

/** The dropped files, also below folders, without hidden ones. Call it within the drop event. */
export function droppedFiles({ items }) {
  return Array.fromAsync(filesOf([...items].map((item) => item.webkitGetAsEntry()).filter(Boolean)));
}

async function* filesOf(entries) {
  for (const entry of entries.filter(({ name }) => !name.startsWith("."))) {
    if (entry.isFile) yield new Promise((done, failed) => entry.file(done, failed));
    const reader = entry.isDirectory && entry.createReader(); // gives a hundred entries at a time
    const more = () => new Promise((done, failed) => reader.readEntries(done, failed));
    for (let some; reader && (some = await more()).length;) yield* filesOf(some);
  }
}

/** One or two files as they are; of more files, the first `MOST` photographs by name. */
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

/** End the table: no further pair is estimated. Returns the number of the next table. */
export function endPairs() {
  at("pairs").hidden = true;
  return ++newest;
}

/** List the pairs of images. choose: called with both images of a clicked row. */
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

/** Estimate the pairs and fill the table, row by row. */
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
  const known = new Map(facts(pose)); // by the names of the columns
  for (const { textContent: name } of [...at("pairs").querySelectorAll("th")].slice(2)) {
    Object.assign(row.insertCell(), { textContent: known.get(name) ?? "" }).dataset.name = name;
  }
}
