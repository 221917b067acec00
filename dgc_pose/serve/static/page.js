// The page: it takes K and photographs, and shows a pose.
import { picture } from "./canvas.js";
import { droppedFiles, endPairs, estimatePairs, listPairs, newest as newestPairs, photographsOf } from "./pairs.js";
import { drawHistogram, drawMap } from "./plots.js";
import { describe, summary } from "./result.js";
import { saveJson, savePng } from "./save.js";
import { Scene } from "./scene.js";
import { bundledPair, estimated, sendFile } from "./server.js";
import { View } from "./view.js";

const at = (id) => document.getElementById(id);
const images = [null, null]; // the server's answers for both images
const rejections = ["", ""]; // for each place, why its latest photograph was rejected
let result = null;
let resultInputs = ""; // the `inputs` of the result
let pairsKnown = ""; // the `known` camera of the table
let pictures = null; // of both images, and of the map
let shownImages = 0; // count of images shown, which numbers them
let running = 0; // number of the newest request; older answers are ignored
let drawn = 150; // chosen number of matches; a result may have fewer
const view = new View(at("view"), at("pointed"));
const scene = new Scene(at("scene"));

/** Show the progress, and the errors: first those of rejected photographs. */
function begin(text, error = "") {
  at("error").textContent = [...rejections, error].filter(Boolean).join("; ");
  at("error").hidden = !at("error").textContent;
  at("progress").textContent = text;
}

function fail(error) {
  begin("", error.message);
}

function kind() {
  return document.querySelector("input[name=kind]:checked").value;
}

/** The inputs about K, as a text. */
function known() {
  const fields = [...document.querySelectorAll(`[data-kind=${kind()}] input`)];
  return JSON.stringify([kind(), fields.map(({ value }) => value.trim())]);
}

/** All inputs of a result, as a text. */
function inputs() {
  return JSON.stringify([images.map((image) => image?.number), known()]);
}

/** Grey out results whose inputs differ from those on the page. */
function compare() {
  at("result").classList.toggle("stale", inputs() !== resultInputs);
  at("pairs").classList.toggle("stale", known() !== pairsKnown);
}

function show(index, image) {
  [images[index], rejections[index]] = [{ ...image, number: ++shownImages }, ""];
  at(`picture${index + 1}`).src = image.picture;
  at(`picture${index + 1}`).alt = image.name;
  at(`picture${index + 1}`).hidden = false;
  const [width, height] = image.size;
  at(`caption${index + 1}`).textContent = `${image.name}, ${width} x ${height}`;
  at("estimate").disabled = images.includes(null);
  compare();
}

/** Send photographs. One fills the place `index`, two fill both, more give a table of pairs. */
async function sendAll(index, files) {
  const [number, photographs, sent, failures] = [endPairs(), photographsOf(files), [], []];
  for (const file of photographs) {
    begin(`sending ${file.name}`);
    await sendFile(file).then((image) => sent.push(image), ({ message }) => failures.push(message));
  }
  if (photographs.length > 2 && number !== newestPairs) return; // newer photographs were dropped
  sent.slice(0, 2).forEach((image, n) => show(photographs.length > 1 ? n : index, image));
  rejections[index] = failures.join("; ");
  begin("");
  if (photographs.length > 2) {
    listPairs(sent, (pair) => { pair.forEach((image, n) => show(n, image)); estimate(); });
    estimateAll();
  } else if (sent.length && !failures.length && !images.includes(null)) estimate();
}

function camera() {
  return { kind: kind(), fov: at("fov").valueAsNumber, k1: at("k1").value, k2: at("k2").value };
}

function estimateAll() {
  pairsKnown = known();
  compare();
  estimatePairs(camera());
}

async function estimate() {
  const number = ++running;
  begin("loading the network");
  at("estimate").disabled = true;
  try {
    const [pair, asked, how] = [[...images], inputs(), kind()];
    for await (const line of estimated(pair, camera())) {
      if (number !== running) return;
      if (line.progress) at("progress").textContent = line.progress;
      if (line.result) await present(line.result, pair, asked, how);
    }
  } catch (error) {
    if (number === running) fail(error);
  } finally {
    if (number === running) at("estimate").disabled = images.includes(null);
  }
}

async function present(answer, pair, asked, how) {
  const { map, matches: { points } } = answer;
  pictures = await Promise.all([...pair.map((image) => image.picture), map?.warp, map?.matchability].map(picture));
  [result, resultInputs] = [answer, asked];
  at("result").hidden = false;
  compare();
  describe(answer, how);
  at("command").textContent = answer.command;
  at("python").textContent = answer.python;
  for (const part of document.querySelectorAll("[data-posed]")) part.hidden = answer.F === null;
  for (const part of document.querySelectorAll("[data-covered]")) part.hidden = !map?.warp;
  at("map-part").hidden = map === null;
  const share = map?.warp ? `${(100 * map.covered).toFixed(0)} %` : "less than 1 %";
  at("covered").textContent = `The map has points in image 1 for ${share} of image 2.`;
  at("view-title").textContent = answer.F === null ? "Matches" : "Matches and epipolar lines";
  at("count").max = Math.max(10, points.length);
  at("count").value = drawn;
  at("view-tools").hidden = points.length === 0;
  view.show(answer, pictures[0], pictures[1]);
  scene.show(answer.scene);
  at("scene-part").hidden = scene.points === null;
  redraw();
  const seconds = Object.values(answer.pose.seconds).reduce((sum, part) => sum + part, 0);
  at("progress").textContent = `done in ${seconds.toFixed(2)} s`;
  at("result").scrollIntoView({ block: "start" });
}

function redraw() {
  if (result === null) return;
  const most = view.setLimit(Number(at("limit").value) / 100);
  at("scale-text").textContent = view.scale === null ? "" : `${view.scale.toFixed(2)} px`;
  at("limit-text").textContent = most === null ? "" : `${most.toFixed(2)} px`;
  at("count-text").textContent = at("count").value;
  view.options = {
    count: Number(at("count").value),
    lines: at("show-lines").checked,
    outliers: at("show-outliers").checked,
    epipolar: at("show-epipolar").checked,
  };
  view.draw();
  scene.draw();
  const shown = at("show-matchability").checked;
  drawMap(at("map"), pictures[1], pictures[2], shown ? pictures[3] : null, Number(at("blend").value) / 100);
  if (result.F) drawHistogram(at("histogram"), result.matches);
}

for (const index of [0, 1]) {
  const zone = at(`drop${index + 1}`);
  const input = at(`file${index + 1}`);
  input.addEventListener("change", () => {
    sendAll(index, [...input.files]);
    input.value = "";
  });
  zone.addEventListener("dragover", () => zone.classList.add("over"));
  zone.addEventListener("dragleave", () => zone.classList.remove("over"));
  zone.addEventListener("drop", (event) => {
    zone.classList.remove("over");
    droppedFiles(event.dataTransfer).then((files) => sendAll(index, files)).catch(fail);
  });
}
// By default, a file dropped outside the zones would replace the page.
for (const name of ["dragover", "drop"]) addEventListener(name, (event) => event.preventDefault());

at("estimate").addEventListener("click", estimate);
at("estimate-pairs").addEventListener("click", estimateAll);
at("example").addEventListener("click", () => {
  document.querySelector("input[name=kind][value=auto]").checked = true;
  bundledPair().then((files) => sendAll(0, files)).catch(fail);
});
at("camera").addEventListener("input", compare);
at("camera").addEventListener("keydown", (event) => {
  if (event.key === "Enter" && !at("estimate").disabled) estimate();
});
at("count").addEventListener("input", () => { drawn = at("count").value; });
for (const id of ["count", "limit", "blend", "show-lines", "show-outliers", "show-epipolar", "show-matchability"]) {
  at(id).addEventListener("input", redraw);
}
for (const button of document.querySelectorAll("[data-copy]")) {
  button.addEventListener("click", async () => {
    await navigator.clipboard.writeText(at(button.dataset.copy).textContent);
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = "Copy"; }, 1500);
  });
}
at("save-json").addEventListener("click", () => saveJson(result));
at("save-png").addEventListener("click", () => {
  savePng([result.names.join("  and  "), summary(result)], ["view", "scene", "map", "histogram"].map(at));
});
addEventListener("resize", redraw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
