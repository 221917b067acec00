// Both images with their matches. For the point under the pointer: epipolar lines, and its point
// in the other image by the dense map. Points are in pixels of the originals, (0, 0) the centre of
// the top-left pixel.
import { inlierResiduals, prepared } from "./canvas.js";
import { Correspondences } from "./correspondences.js";

const GAP = 8; // between the images, CSS pixels
const NEAR = 12; // largest distance of the pointer from a match, CSS pixels
const NARROW = 560; // CSS pixels; a narrower canvas stacks the images if that makes them larger
const EPIPOLAR = "#ffe14d";
const UNDECIDED = "#f2f5f8"; // colour of matches without a pose: neither inliers nor outliers
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/** Both images, with the drawings on them. */
export class View {
  constructor(canvas, text) {
    this.canvas = canvas;
    this.text = text;
    for (const name of ["pointerdown", "pointermove"]) {
      canvas.addEventListener(name, (event) => this.pointAt(event.offsetX, event.offsetY));
    }
    canvas.addEventListener("pointerleave", (event) => {
      if (event.pointerType === "mouse") this.pointAt(); // a finger's point stays
    });
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  show(result, first, second) {
    this.result = result;
    this.images = [first, second];
    this.correspondences = result.correspondences && new Correspondences(result.correspondences, result.sizes[0]);
    this.pointer = null; // [image, x, y], pixels of that image
    const [known, nearlyAll] = result.F ? inlierResiduals(result.matches) : [[]];
    this.scale = known.length ? Math.max(0.01, nearlyAll) : null;
    this.largest = known.at(-1) ?? null;
  }

  /** Show inliers up to a share of the largest residual. Returns the limit, null if unknown. */
  setLimit(share) {
    this.limit = this.largest === null ? null : share * this.largest;
    return this.limit;
  }

  draw() {
    if (!this.result) return;
    this.places = placed(this.result.sizes, this.canvas.clientWidth);
    const [paint] = prepared(this.canvas, Math.round(this.places[1].top + this.places[1].height));
    this.images.forEach((image, n) => {
      const { left, top, width, height } = this.places[n];
      paint.drawImage(image, left, top, width, height);
    });
    const nearest = this.nearest();
    if (this.options.lines) for (const n of this.shown()) this.drawMatch(paint, n, this.pointer !== null);
    if (nearest !== null) this.drawMatch(paint, nearest, false, true);
    const other = this.corresponding();
    if (this.pointer) {
      const image = this.pointer[0];
      const lines = this.options.epipolar && this.result.F ? this.epipolarLines() : [];
      lines.forEach((line, n) => this.drawLine(paint, n === 0 ? image : 1 - image, line));
      this.drawPoint(paint, ...this.pointer, EPIPOLAR);
      if (other) this.drawPoint(paint, 1 - this.pointer[0], other.x, other.y, "#ffffff");
    }
    this.describe(nearest, other);
  }

  /** The indices of the drawn matches: inliers up to the limit, and outliers if chosen. */
  shown() {
    const { inlier, residual } = this.result.matches;
    const posed = this.scale !== null;
    const numbers = [];
    for (let n = 0; n < inlier.length && numbers.length < this.options.count; n++) {
      const fits = inlier[n] && (residual[n] === null || residual[n] <= this.limit);
      if (fits || !posed) numbers.push(n);
    }
    if (this.options.outliers && posed) {
      inlier.forEach((fits, n) => { if (!fits && numbers.length < 2 * this.options.count) numbers.push(n); });
    }
    return numbers;
  }

  colour(n) {
    const { inlier, residual } = this.result.matches;
    if (this.scale === null) return UNDECIDED;
    if (!inlier[n]) return "#ffb020";
    const share = residual[n] === null ? 0 : Math.min(1, residual[n] / this.scale);
    return `rgb(${Math.round(255 * share)}, ${Math.round(255 * (1 - share))}, 255)`;
  }

  /** The place on the canvas of a point of an image. */
  place(image, x, y) {
    const { left, top, scale } = this.places[image];
    return [left + (x + 0.5) * scale, top + (y + 0.5) * scale];
  }

  drawMatch(paint, n, faint, strong = false) {
    const [x1, y1, x2, y2] = this.result.matches.points[n];
    const [from, to] = [this.place(0, x1, y1), this.place(1, x2, y2)];
    const [line, dot] = strong ? [2.5, 5] : [1.2, 2];
    paint.globalAlpha = faint ? 0.25 : 0.85;
    for (const [style, edge] of [["#000a", 0.6], [strong ? "#ffffff" : this.colour(n), 0]]) { // a dark edge first
      paint.strokeStyle = paint.fillStyle = style;
      paint.lineWidth = line + 2 * edge;
      paint.beginPath();
      paint.moveTo(...from);
      paint.lineTo(...to);
      paint.stroke();
      for (const [x, y] of [from, to]) {
        paint.beginPath();
        paint.arc(x, y, dot + edge, 0, 7);
        paint.fill();
      }
    }
    paint.globalAlpha = 1;
  }

  drawPoint(paint, image, x, y, style) {
    paint.lineWidth = 1.5;
    paint.strokeStyle = "#000";
    paint.fillStyle = style;
    paint.beginPath();
    paint.arc(...this.place(image, x, y), 5, 0, 7);
    paint.fill();
    paint.stroke();
  }

  /** The epipolar lines of the pointer's point: first in its own image, then in the other. */
  epipolarLines() {
    const [image, x, y] = this.pointer;
    const F = this.result.F;
    const matrix = image === 0 ? F : transposed(F); // to lines of the other image
    const [a, b, c] = apply(matrix, [x, y, 1]);
    // Any point on the line in the other image has the same epipolar line in the pointer's image.
    return [apply(transposed(matrix), [-a * c, -b * c, a * a + b * b]), [a, b, c]];
  }

  /** Draw a line a x + b y + c = 0 across its image. */
  drawLine(paint, image, [a, b, c]) {
    const norm = Math.hypot(a, b);
    if (!(norm > 0)) return; // the point is the epipole
    const [wide, tall] = this.result.sizes[image];
    const foot = [-a * c / norm ** 2, -b * c / norm ** 2];
    const far = Math.hypot(...foot) + wide + tall;
    const along = [b / norm * far, -a / norm * far];
    const { left, top, width, height } = this.places[image];
    paint.save();
    paint.beginPath();
    paint.rect(left, top, width, height);
    paint.clip();
    for (const [style, thick] of [["#000", 3.5], [EPIPOLAR, 1.8]]) {
      paint.strokeStyle = style;
      paint.lineWidth = thick;
      paint.beginPath();
      paint.moveTo(...this.place(image, foot[0] - along[0], foot[1] - along[1]));
      paint.lineTo(...this.place(image, foot[0] + along[0], foot[1] + along[1]));
      paint.stroke();
    }
    paint.restore();
  }

  /** Set the pointer to a place of the canvas, CSS pixels; unset it outside or without a place. */
  pointAt(x, y) {
    if (!this.places) return;
    const image = this.places.findIndex(({ left, top, width, height }) => (
      left <= x && x <= left + width && top <= y && y <= top + height));
    this.pointer = null;
    if (image >= 0) {
      const { left, top, scale } = this.places[image];
      this.pointer = [image, (x - left) / scale - 0.5, (y - top) / scale - 0.5];
    }
    this.draw();
  }

  /** The arrow keys move the pointer, with Shift by one CSS pixel; also into the other image. */
  key(event) {
    if (!this.places || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Escape") this.pointAt();
    if (!(event.key in ARROWS)) return;
    event.preventDefault();
    const [dx, dy] = ARROWS[event.key].map((step) => step * (event.shiftKey ? 1 : 8));
    if (!this.pointer) {
      const { left, top, width, height } = this.places[0];
      this.pointAt(left + width / 2, top + height / 2);
      return;
    }
    const [x, y] = this.place(...this.pointer);
    const [from, to] = [this.places[this.pointer[0]], this.places[1 - this.pointer[0]]];
    const inside = ({ left, top, width, height }) => (
      [Math.min(left + width, Math.max(left, x + dx)), Math.min(top + height, Math.max(top, y + dy))]);
    const [across, down] = inside(from);
    const leaves = (to.left - from.left) * (x + dx - across) + (to.top - from.top) * (y + dy - down) > 0;
    this.pointAt(...inside(leaves ? to : from));
  }

  /** The pointer's point in the other image, by the map; null without one. */
  corresponding() {
    if (!this.pointer || !this.correspondences) return null;
    const [image, x, y] = this.pointer;
    return image === 0 ? this.correspondences.inImage2(x, y) : this.correspondences.inImage1(x, y);
  }

  /** The index of the drawn match nearest to the pointer; null if none is near. */
  nearest() {
    if (!this.pointer || !this.options.lines) return null;
    const [image, x, y] = this.pointer;
    let [best, least] = [null, NEAR / this.places[image].scale];
    for (const n of this.shown()) {
      const point = this.result.matches.points[n].slice(2 * image, 2 * image + 2);
      const distance = Math.hypot(point[0] - x, point[1] - y);
      if (distance < least) [best, least] = [n, distance];
    }
    return best;
  }

  describe(nearest, other) {
    const { F } = this.result;
    if (!this.pointer) {
      const shown = [F && "the epipolar lines", this.correspondences && "its point in the other image"].filter(Boolean);
      const hint = shown.length ? [`Point at an image, or use the arrow keys, to see ${shown.join(" and ")}.`] : [];
      const lack = F ? [] : ["There is no pose, so there are no epipolar lines."];
      this.text.textContent = [...hint, ...lack].join(" ");
      return;
    }
    const [image, x, y] = this.pointer;
    let text = `image ${image + 1} (${x.toFixed(1)}, ${y.toFixed(1)})`;
    if (other) {
      text += ` — image ${2 - image} (${other.x.toFixed(1)}, ${other.y.toFixed(1)}) by the map, matchability ${other.matchability.toFixed(2)}`;
      if (F) text += `, ${distance(this.epipolarLines()[1], other).toFixed(2)} px from the epipolar line`;
    } else if (this.correspondences) {
      text += `: the map has no point in image ${2 - image}`;
    }
    if (nearest !== null) {
      const { points, residual, confidence, inlier } = this.result.matches;
      const [x1, y1, x2, y2] = points[nearest];
      text += `; match (${x1}, ${y1}) — (${x2}, ${y2}), confidence ${confidence[nearest]}`;
      if (residual[nearest] !== null) text += `, residual ${residual[nearest]} px`;
      if (this.scale !== null) text += inlier[nearest] ? ", inlier" : ", outlier";
    }
    this.text.textContent = text;
  }
}

/** The places of the images on a canvas of this width: side by side, or one above the other. */
function placed(sizes, width) {
  const most = Math.max(360, 0.85 * innerHeight); // largest height
  const [aspect1, aspect2] = sizes.map(([w, h]) => w / h);
  const tall = Math.min(most, (width - GAP) / (aspect1 + aspect2)); // height if side by side
  const wide = Math.min(width, (most - GAP) / (1 / aspect1 + 1 / aspect2)); // width if stacked
  const above = width < NARROW && wide > tall * Math.max(aspect1, aspect2);
  let [left, top] = [(width - (above ? wide : tall * (aspect1 + aspect2) + GAP)) / 2, 0];
  return sizes.map(([w, h]) => {
    const scale = above ? wide / w : tall / h;
    const place = { left, top, width: scale * w, height: scale * h, scale };
    if (above) top += place.height + GAP;
    else left += place.width + GAP;
    return place;
  });
}

/** The distance from a line a x + b y + c = 0 to a point. */
function distance([a, b, c], { x, y }) {
  return Math.abs(a * x + b * y + c) / Math.hypot(a, b);
}

function transposed(matrix) {
  return matrix[0].map((_, column) => matrix.map((row) => row[column]));
}

function apply(matrix, vector) {
  return matrix.map((row) => row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2]);
}
