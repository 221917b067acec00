// A result in words and numbers.

const at = (id) => document.getElementById(id);
const SUCCESS = { ok: "R and t are known, t up to scale.", planar: "R and t are known, t up to scale, from a nearly planar scene." };
const SOURCES = { exif: " by EXIF data", size: " by the size of the image", matches: " by the matches" };
const BASES = {
  auto: "K is not known: the focal length below is estimated. A known K gives a more accurate pose.",
  fov: "K comes from the field of view: if the angle is wrong, so is the pose.",
};

/** Fill in the verdict and the facts. kind: how K was given. */
export function describe(result, kind) {
  const { pose, reason } = result;
  const explanations = pose.status === "ambiguous" ? pose.alternatives : [];
  const { sort, title, why } = verdict(pose, reason);
  at("banner").className = sort;
  at("banner").querySelector("use").setAttribute("href", `#${sort}`);
  at("verdict").textContent = title;
  at("reason").textContent = why;
  at("basis").textContent = BASES[kind] ?? "";
  at("basis").hidden = !(kind in BASES) || !pose.R;
  at("poses").replaceChildren(...explanations.map(explanation));
  if (pose.R) at("poses").append(equations(pose, "cam2_from_cam1: x2 = R x1 + t"));
  at("numbers").replaceChildren(...facts(pose).flatMap(([name, text, rest = ""]) => [element("dt", name), element("dd", text + rest)]));
  alternatives(explanations.length ? [] : pose.alternatives);
  at("warnings").replaceChildren(
    ...pose.warnings.filter((text) => text !== reason).map((text) => element("li", text)),
  );
}

/** The facts as one line, for a picture. */
export function summary({ pose, reason }) {
  const { title, why } = verdict(pose, reason);
  const numbers = facts(pose).map(([name, text, rest = ""]) => `${name} ${text}${rest}`).join("; ");
  return `${title}. ${pose.success ? "" : `${why} `}${numbers}`;
}

export function verdict({ status, success, R, alternatives: others }, reason) {
  if (success) return { sort: "good", title: "A pose", why: SUCCESS[status] };
  if (status === "ambiguous") {
    const count = others.length === 2 ? "Two" : others.length;
    const why = "The matches do not show which pose is right, so there is no result. The likeliest pose is first; each is x2 = R x1 + t.";
    return { sort: "doubt", title: `${count} poses explain these photographs`, why };
  }
  const why = `${reason[0].toUpperCase()}${reason.slice(1)} (${status}).`;
  return R ? { sort: "doubt", title: "A pure rotation", why } : { sort: "bad", title: "No pose", why };
}

export function element(name, text, className = "") {
  const made = document.createElement(name);
  made.textContent = text;
  made.className = className;
  return made;
}

/** R and t of a pose in brackets. */
function equations({ R, t }, caption) {
  const whole = document.createElement("figure");
  const both = element("div", "", "equation");
  both.append(equation("R", matrix(R)));
  both.append(equation("t", t ? matrix(t.map((value) => [value])) : element("span", "unknown")));
  whole.append(element("figcaption", caption), both);
  return whole;
}

function equation(name, value) {
  const part = document.createElement("span");
  value.setAttribute("aria-label", name);
  part.append(element("i", name), element("span", "="), value);
  return part;
}

function matrix(rows) {
  const table = element("table", "", "matrix");
  for (const row of rows) {
    const line = table.insertRow();
    for (const value of row) line.insertCell().textContent = value.toFixed(6);
  }
  return table;
}

/** One of several poses that explain the matches equally well. */
function explanation(pose, n) {
  const likely = `probability ${likelihood(pose.probability)}`;
  return equations(pose, `Pose ${n + 1}: ${likely}, ${pose.num_inliers} inliers, rotation ${angle(pose.R)}`);
}

function alternatives(others) {
  at("alternatives").hidden = others.length === 0;
  const poses = others.length === 1 ? "1 other pose explains" : `${others.length} other poses explain`;
  at("alternatives").querySelector("summary").textContent = `${poses} the matches about as well`;
  at("alternatives").querySelector("ol").replaceChildren(...others.map((other) => {
    const t = other.t.map((value) => value.toFixed(4)).join(", ");
    const likely = `probability ${likelihood(other.probability)}`;
    return element("li", `rotation angle ${angle(other.R)}, t (${t}), ${other.num_inliers} inliers, ${likely}`);
  }));
}

/** The facts about a pose, each [name, value, explanation]; the explanation may be missing. */
export function facts(pose) {
  const lines = [];
  if (pose.R) lines.push(["rotation angle", angle(pose.R)]);
  if (pose.t) lines.push(["probability", likelihood(pose.probability), ", that R and t are within 10°"]);
  if (pose.rotation_error_90_deg != null) {
    const [R, t] = [pose.rotation_error_90_deg, pose.translation_error_90_deg];
    lines.push(["expected error", `R within ${R.toFixed(3)}°, t within ${t.toFixed(3)}°`, " in 90 % of cases, if the pose is right"]);
  }
  const share = pose.inlier_ratio == null ? "" : ` (${(100 * pose.inlier_ratio).toFixed(1)} %)`;
  const sense = pose.success ? "" : " agree with the best essential matrix";
  lines.push(["inliers", `${pose.num_inliers} of ${pose.num_matches} matches${share}`, sense]);
  if (pose.t && pose.median_triangulation_angle_deg != null) {
    lines.push(["triangulation", `${pose.median_triangulation_angle_deg.toFixed(2)}°, the median angle`]);
  }
  if (pose.camera1 === null) return lines;
  const [first, second] = [intrinsics(pose.camera1), intrinsics(pose.camera2)];
  return [...lines, ...(first === second ? [["K1, K2", first]] : [["K1", first], ["K2", second]])];
}

function likelihood(probability) {
  if (probability == null) return "not known";
  if (probability > 0.995) return "over 99 %";
  return probability < 0.005 ? "below 1 %" : `${(100 * probability).toFixed(0)} %`;
}

/** The angle of a rotation matrix, as a text in degrees. */
function angle(R) {
  const cosine = (R[0][0] + R[1][1] + R[2][2] - 1) / 2;
  return `${(Math.acos(Math.min(1, Math.max(-1, cosine))) * 180 / Math.PI).toFixed(2)}°`;
}

/** The numbers of K, and the source of the focal length. */
function intrinsics({ K, focal_std, focal_source, model }) {
  const [fx, fy, cx, cy] = [K[0][0], K[1][1], K[0][2], K[1][2]].map((value) => value.toFixed(1));
  const deviation = focal_std > 0 ? ` ± ${(focal_std * (K[0][0] + K[1][1]) / 2).toFixed(1)}` : "";
  const focal = fx === fy ? `f ${fx}${deviation}` : `fx ${fx}, fy ${fy}${deviation}`;
  const lens = model === null ? "" : `, ${model}`;
  return `${focal} px${SOURCES[focal_source] ?? ""}, cx ${cx}, cy ${cy}${lens}`;
}
