// The page: photographs in, a pose out. What is drawn is in view.js.
import { View, drawHistogram, drawMap, picture } from "./view.js";

const at = (id) => document.getElementById(id);
const token = document.querySelector("meta[name=token]").content;
const images = [null, null]; // as the server described them
let result = null;
let pictures = null; // of both images, and of the map
let running = 0; // of the newest request; older answers are ignored
const view = new View(at("view"), at("pointed"));

async function ask(path, body, type) {
  const headers = { "x-dgc-pose-token": token, "content-type": type };
  const answer = await fetch(path, { method: "POST", headers, body }).catch(() => null);
  if (answer === null) throw new Error("the server does not answer: is dgc-pose serve still running?");
  if (answer.ok) return answer;
  throw new Error(await answer.text());
}

function fail(error) {
  at("error").textContent = error.message;
  at("error").hidden = false;
  at("progress").textContent = "";
}

function begin(text) {
  at("error").hidden = true;
  at("progress").textContent = text;
}

function show(index, image) {
  images[index] = image;
  at(`picture${index + 1}`).src = image.picture;
  at(`picture${index + 1}`).alt = image.name;
  at(`picture${index + 1}`).hidden = false;
  const [width, height] = image.size;
  const note = image.orientation === 1 ? "" : `, EXIF orientation ${image.orientation} not applied`;
  at(`caption${index + 1}`).textContent = `${image.name}, ${width} x ${height}${note}`;
  at("estimate").disabled = images.includes(null);
}

async function send(index, file) {
  begin(`sending ${file.name}`);
  try {
    const path = `/images?name=${encodeURIComponent(file.name)}`;
    show(index, await (await ask(path, file, "application/octet-stream")).json());
    at("progress").textContent = "";
    return true;
  } catch (error) {
    fail(new Error(`${file.name}: ${error.message}`));
    return false;
  }
}

async function sendAll(index, files) {
  const sent = await Promise.all([...files].slice(0, 2).map((file, n) => send((index + n) % 2, file)));
  if (sent.length && sent.every(Boolean) && !images.includes(null)) estimate();
}

async function camera() {
  const kind = document.querySelector("input[name=kind]:checked").value;
  if (kind !== "file") return { kind, fov: Number(at("fov").value), k1: at("k1").value, k2: at("k2").value };
  const [file] = at("kfile").files;
  return { kind, name: file?.name ?? "", content: file ? await base64(file) : "" };
}

function base64(file) {
  return new Promise((done, failed) => {
    const reader = new FileReader();
    reader.onload = () => done(reader.result.split(",")[1] ?? "");
    reader.onerror = () => failed(new Error(`${file.name}: ${reader.error.message}`));
    reader.readAsDataURL(file);
  });
}

async function estimate() {
  const number = ++running;
  begin("loading the network");
  at("estimate").disabled = true;
  try {
    const request = { image1: images[0].id, image2: images[1].id, camera: await camera() };
    const answer = await ask("/poses", JSON.stringify(request), "application/json");
    const shown = [images[0].picture, images[1].picture];
    for await (const line of lines(answer.body)) {
      if (number !== running) return;
      if (line.error) throw new Error(line.error);
      if (line.progress) at("progress").textContent = line.progress;
      if (line.result) await present(line.result, shown);
    }
  } catch (error) {
    if (number === running) fail(error);
  } finally {
    if (number === running) at("estimate").disabled = images.includes(null);
  }
}

async function* lines(stream) {
  const reader = stream.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    const parts = (rest + value).split("\n");
    rest = parts.pop();
    for (const part of parts) yield JSON.parse(part);
  }
}

async function present(answer, shown) {
  result = answer;
  const map = answer.map;
  pictures = await Promise.all([...shown, map?.warp, map?.matchability].map(picture));
  at("result").hidden = false;
  verdict(answer);
  at("command").textContent = answer.command;
  at("python").textContent = answer.python;
  at("map-part").hidden = map === null;
  at("count").max = Math.max(10, answer.matches.points.length);
  view.show(answer, pictures[0], pictures[1]);
  redraw();
  const seconds = Object.values(answer.pose.seconds).reduce((sum, part) => sum + part, 0);
  at("progress").textContent = `done in ${seconds.toFixed(2)} s`;
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  at("result").scrollIntoView({ behavior: still ? "instant" : "smooth", block: "start" });
}

function verdict({ pose, reason }) {
  const explanations = pose.status === "ambiguous" ? pose.alternatives : [];
  at("verdict").textContent = headline(pose, reason);
  at("undecided").hidden = explanations.length === 0;
  at("poses").replaceChildren(...explanations.map(explanation));
  if (pose.R) at("poses").append(matrix(pose, "cam2_from_cam1: x2 = R x1 + t"));
  const facts = [...numbers(pose), ...cameraNumbers(pose)].flatMap(([name, text]) => {
    const [term, value] = ["dt", "dd"].map((kind) => document.createElement(kind));
    term.textContent = name;
    value.textContent = text;
    return [term, value];
  });
  at("numbers").replaceChildren(...facts);
  alternatives(explanations.length ? [] : pose.alternatives);
  at("warnings").replaceChildren(...pose.warnings.filter((text) => text !== reason).map((text) => {
    const item = document.createElement("li");
    item.textContent = text;
    return item;
  }));
}

function headline({ status, success, alternatives: others }, reason) {
  if (success) return `A pose (${status})`;
  if (status !== "ambiguous") return `No pose (${status}): ${reason}`;
  return `${others.length === 2 ? "Two" : others.length} poses explain these photographs`;
}

/** A table of R and t. */
function matrix({ R, t }, caption) {
  const table = document.createElement("table");
  table.createCaption().textContent = caption;
  R.forEach((row, n) => {
    const line = table.insertRow();
    for (const part of ["R", ...row, "t", t ? t[n] : "unknown"]) {
      const cell = line.insertCell();
      cell.textContent = typeof part === "number" ? part.toFixed(6) : part;
      cell.className = part === "R" || part === "t" ? "name" : "";
    }
  });
  return table;
}

/** One of several poses that explain the matches alike. */
function explanation(pose, n) {
  const likely = `probability ${likelihood(pose.probability)}`;
  return matrix(pose, `Pose ${n + 1}: ${likely}, ${pose.num_inliers} inliers, rotation ${angle(pose.R)}`);
}

function alternatives(others) {
  at("alternatives").hidden = others.length === 0;
  const poses = others.length === 1 ? "1 other pose explains" : `${others.length} other poses explain`;
  at("alternatives").querySelector("summary").textContent = `${poses} the matches about as well`;
  at("alternatives").querySelector("ol").replaceChildren(...others.map((other) => {
    const item = document.createElement("li");
    const t = other.t.map((value) => value.toFixed(4)).join(", ");
    const likely = other.probability == null ? "" : `, probability ${likelihood(other.probability)}`;
    item.textContent = `rotation angle ${angle(other.R)}, t (${t}), ${other.num_inliers} inliers${likely}`;
    return item;
  }));
}

function likelihood(probability) {
  if (probability > 0.995) return "over 99 %";
  return probability < 0.005 ? "below 1 %" : percent(probability);
}

function percent(share) {
  return `${(100 * share).toFixed(0)} %`;
}

/** Of a rotation matrix, in degrees. */
function angle(R) {
  const cosine = (R[0][0] + R[1][1] + R[2][2] - 1) / 2;
  return `${(Math.acos(Math.min(1, Math.max(-1, cosine))) * 180 / Math.PI).toFixed(2)}°`;
}

function numbers(pose) {
  const facts = [];
  if (pose.R) facts.push(["rotation angle", angle(pose.R)]);
  if (pose.t && pose.probability != null) {
    facts.push(["probability", `${likelihood(pose.probability)}, that R and t are within 10°`]);
  }
  if (pose.rotation_error_90_deg != null) {
    const [R, t] = [pose.rotation_error_90_deg, pose.translation_error_90_deg];
    facts.push(["expected error", `R within ${R.toFixed(3)}°, t within ${t.toFixed(3)}°, nine times in ten`]);
  }
  const share = pose.inlier_ratio == null ? "" : ` (${(100 * pose.inlier_ratio).toFixed(1)} %)`;
  facts.push(["inliers", `${pose.num_inliers} of ${pose.num_matches} matches${share}`]);
  if (pose.t && pose.median_triangulation_angle_deg != null) {
    facts.push(["triangulation angle", `${pose.median_triangulation_angle_deg.toFixed(2)}°, the median`]);
  }
  return facts;
}

function cameraNumbers({ camera1, camera2 }) {
  if (camera1 === null) return [];
  const [first, second] = [intrinsics(camera1), intrinsics(camera2)];
  return first === second ? [["K1, K2", first]] : [["K1", first], ["K2", second]];
}

const SOURCES = { exif: " by EXIF data", size: " by the size of the image", matches: " by the matches" };

/** The numbers of K, and what the focal length is known from. */
function intrinsics({ K, focal_std, focal_source, model }) {
  const [fx, fy, cx, cy] = [K[0][0], K[1][1], K[0][2], K[1][2]].map((value) => value.toFixed(1));
  const deviation = focal_std > 0 ? ` ± ${(focal_std * (K[0][0] + K[1][1]) / 2).toFixed(1)}` : "";
  const focal = fx === fy ? `f ${fx}${deviation}` : `fx ${fx}, fy ${fy}${deviation}`;
  const lens = model === null ? "" : `, ${model}`;
  return `${focal} px${SOURCES[focal_source] ?? ""}, cx ${cx}, cy ${cy}${lens}`;
}

function redraw() {
  if (result === null) return;
  const most = view.setLimit(Number(at("limit").value) / 100);
  at("scale").hidden = view.scale === null;
  at("scale-text").textContent = view.scale === null ? "" : `${view.scale.toFixed(2)} px`;
  at("limit-text").textContent = most === null ? "unknown" : `${most.toFixed(2)} px`;
  at("count-text").textContent = at("count").value;
  view.options = {
    count: Number(at("count").value),
    lines: at("show-lines").checked,
    outliers: at("show-outliers").checked,
    epipolar: at("show-epipolar").checked,
  };
  view.draw();
  const shown = at("show-matchability").checked;
  drawMap(at("map"), pictures[1], pictures[2], shown ? pictures[3] : null, Number(at("blend").value) / 100);
  const side = at("histogram").getBoundingClientRect().top === at("map").getBoundingClientRect().top;
  drawHistogram(at("histogram"), result.matches, side ? at("map").clientHeight : 0);
}

function save(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

function saveJson() {
  const { pose, names, sizes, matches, command } = result;
  const text = JSON.stringify({ ...pose, images: names, sizes, matches, command }, null, 2);
  save("pose.json", new Blob([text + "\n"], { type: "application/json" }));
}

function savePng() {
  const drawn = [at("view"), at("map"), at("histogram")];
  const [top, ...below] = result.map === null ? [drawn[0]] : drawn;
  const canvas = document.createElement("canvas");
  const unit = devicePixelRatio;
  canvas.width = top.width;
  canvas.height = top.height + Math.max(0, ...below.map((part) => part.height)) + 60 * unit;
  const paint = canvas.getContext("2d");
  paint.fillStyle = "white";
  paint.fillRect(0, 0, canvas.width, canvas.height);
  paint.fillStyle = "#1d2733";
  paint.font = `${15 * unit}px system-ui, sans-serif`;
  const facts = numbers(result.pose).map(([name, text]) => `${name} ${text}`).join("; ");
  paint.fillText(result.names.join("  and  "), 4 * unit, 18 * unit, canvas.width);
  paint.fillText(`${at("verdict").textContent}; ${facts}`, 4 * unit, 40 * unit, canvas.width - 8 * unit);
  paint.drawImage(top, 0, 50 * unit);
  let left = 0;
  for (const part of below) {
    paint.drawImage(part, left, top.height + 60 * unit);
    left += part.width + 12 * unit;
  }
  canvas.toBlob((blob) => save("pose.png", blob), "image/png");
}

for (const index of [0, 1]) {
  const zone = at(`drop${index + 1}`);
  const input = at(`file${index + 1}`);
  input.addEventListener("change", () => sendAll(index, input.files).then(() => { input.value = ""; }));
  zone.addEventListener("dragover", (event) => { event.preventDefault(); zone.classList.add("over"); });
  zone.addEventListener("dragleave", () => zone.classList.remove("over"));
  zone.addEventListener("drop", (event) => {
    event.preventDefault();
    zone.classList.remove("over");
    sendAll(index, event.dataTransfer.files);
  });
}
// A file dropped beside the zones would replace the page.
for (const name of ["dragover", "drop"]) addEventListener(name, (event) => event.preventDefault());

at("estimate").addEventListener("click", estimate);
at("example").addEventListener("click", async () => {
  begin("reading the bundled pair");
  try {
    const example = await (await ask("/example", "", "application/json")).json();
    example.images.forEach((image, index) => show(index, image));
    document.querySelector("input[name=kind][value=k]").checked = true;
    [at("k1").value, at("k2").value] = example.k;
    await estimate();
  } catch (error) {
    fail(error);
  }
});
for (const [id, kind] of [["k1", "k"], ["k2", "k"], ["fov", "fov"], ["kfile", "file"]]) {
  at(id).addEventListener("input", () => { document.querySelector(`input[value=${kind}]`).checked = true; });
  at(id).addEventListener("keydown", (event) => {
    if (event.key === "Enter" && !at("estimate").disabled) estimate();
  });
}
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
at("save-json").addEventListener("click", saveJson);
at("save-png").addEventListener("click", savePng);
addEventListener("resize", redraw);
