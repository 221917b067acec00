// Save a result as a file.
import { colour } from "./canvas.js";

const GAP = 14; // between the parts of a picture, CSS pixels
const LINE = 22; // height of a line of text, CSS pixels

export function saveJson({ pose, names, sizes, matches, command }) {
  const text = JSON.stringify({ ...pose, images: names, sizes, matches, command }, null, 2);
  save("pose.json", new Blob([text + "\n"], { type: "application/json" }));
}

/** Save the drawings as one picture, each as large as on the page, below lines of text. */
export function savePng(texts, canvases) {
  const unit = devicePixelRatio;
  const parts = canvases.filter((part) => part.clientWidth);
  const canvas = document.createElement("canvas");
  const paint = canvas.getContext("2d");
  const width = Math.max(...parts.map((part) => part.width));
  const font = `${15 * unit}px system-ui, sans-serif`;
  paint.font = font;
  const lines = texts.flatMap((text) => broken(paint, text, width - 2 * GAP * unit));
  const places = [];
  let [left, top, bottom] = [0, (LINE * lines.length + GAP) * unit, (LINE * lines.length + GAP) * unit];
  for (const part of parts) {
    if (left && left + part.width > width) [left, top] = [0, bottom + GAP * unit];
    places.push([part, left, top]);
    bottom = Math.max(bottom, top + part.height);
    left += part.width + GAP * unit;
  }
  canvas.width = width;
  canvas.height = bottom;
  paint.fillStyle = colour("card");
  paint.fillRect(0, 0, canvas.width, canvas.height);
  paint.fillStyle = colour("ink");
  paint.font = font;
  lines.forEach((line, n) => paint.fillText(line, GAP * unit, (LINE * (n + 1) - 4) * unit));
  for (const place of places) paint.drawImage(...place);
  canvas.toBlob((blob) => save("pose.png", blob), "image/png");
}

/** A text broken into lines that fit into a width. */
function broken(paint, text, width) {
  const lines = [""];
  for (const word of text.split(" ")) {
    const longer = `${lines.at(-1)} ${word}`.trim();
    if (lines.at(-1) && paint.measureText(longer).width > width) lines.push(word);
    else lines[lines.length - 1] = longer;
  }
  return lines;
}

function save(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
