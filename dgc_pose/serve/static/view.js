// What is drawn: both images with their matches, the map, the histogram. Points are in pixels of the
// originals, (0, 0) the centre of the top-left pixel.

const GAP = 8; // between the images, CSS pixels
const NEAR = 12; // how far the pointer may be from a match, CSS pixels
const INLIER = "#18b6c9";
const OUTLIER = "#e26bb5";
const EPIPOLAR = "#ffe14d";

/** An image of an address, decoded; null for none. */
export async function picture(url) {
  if (!url) return null;
  const image = new Image();
  image.src = url;
  await image.decode();
  return image;
}

/** A canvas as large as it is shown, of this height over its width; in CSS pixels. */
function prepared(canvas, aspect) {
  const width = canvas.clientWidth;
  const height = Math.round(width * aspect);
  canvas.width = Math.round(width * devicePixelRatio);
  canvas.height = Math.round(height * devicePixelRatio);
  canvas.style.height = `${height}px`;
  const paint = canvas.getContext("2d");
  paint.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
  return [paint, width, height];
}

/** Both images side by side at one height, and what is drawn on them. */
export class View {
  constructor(canvas, text) {
    this.canvas = canvas;
    this.text = text;
    this.pointer = null; // [image, x, y], pixels of that image
    this.options = { count: 150, lines: true, outliers: false, epipolar: true };
    canvas.addEventListener("pointermove", (event) => this.point(event));
    canvas.addEventListener("pointerleave", () => { this.pointer = null; this.draw(); });
  }

  show(result, first, second) {
    this.result = result;
    this.images = [first, second];
    this.pointer = null;
    const known = result.matches.residual.filter((value, n) => value !== null && result.matches.inlier[n]);
    known.sort((a, b) => a - b);
    this.scale = known.length ? Math.max(0.01, known[Math.floor(0.95 * (known.length - 1))]) : null;
    this.largest = known.length ? known[known.length - 1] : null;
  }

  /** Show inliers up to a share of the largest residual. Returns that residual, null if unknown. */
  setLimit(share) {
    this.limit = this.largest === null ? null : share * this.largest;
    return this.limit;
  }

  draw() {
    if (!this.result) return;
    const [[w1, h1], [w2, h2]] = this.result.sizes;
    const width = this.canvas.clientWidth;
    const height = (width - GAP) / (w1 / h1 + w2 / h2);
    const [paint] = prepared(this.canvas, height / width);
    const left = height * w1 / h1 + GAP;
    this.places = [{ left: 0, scale: height / h1 }, { left, scale: height / h2 }];
    this.size = [[0, height * w1 / h1], [left, width]];
    this.images.forEach((image, n) => {
      paint.drawImage(image, this.size[n][0], 0, this.size[n][1] - this.size[n][0], height);
    });
    const nearest = this.nearest();
    if (this.options.lines) for (const n of this.shown()) this.drawMatch(paint, n, nearest !== null);
    if (nearest !== null) this.drawMatch(paint, nearest, false, true);
    if (this.options.epipolar && this.pointer && this.result.F) this.drawEpipolar(paint, height);
    this.describe(nearest);
  }

  /** The matches drawn, by number: inliers up to the residual, and outliers if asked for. */
  shown() {
    const { inlier, residual } = this.result.matches;
    const anyInlier = inlier.includes(true);
    const numbers = [];
    for (let n = 0; n < inlier.length && numbers.length < this.options.count; n++) {
      const fits = inlier[n] && (residual[n] === null || residual[n] <= this.limit);
      if (fits || !anyInlier) numbers.push(n);
    }
    if (this.options.outliers && anyInlier) {
      inlier.forEach((fits, n) => { if (!fits && numbers.length < 2 * this.options.count) numbers.push(n); });
    }
    return numbers;
  }

  colour(n) {
    const { inlier, residual } = this.result.matches;
    if (!inlier[n]) return "#ffb020";
    const share = residual[n] === null ? 0 : Math.min(1, residual[n] / this.scale);
    return `rgb(${Math.round(255 * share)}, ${Math.round(255 * (1 - share))}, 255)`;
  }

  /** A point of an image on the canvas. */
  place(image, x, y) {
    const { left, scale } = this.places[image];
    return [left + (x + 0.5) * scale, (y + 0.5) * scale];
  }

  drawMatch(paint, n, faint, strong = false) {
    const [x1, y1, x2, y2] = this.result.matches.points[n];
    const [from, to] = [this.place(0, x1, y1), this.place(1, x2, y2)];
    paint.globalAlpha = faint ? 0.25 : 0.85;
    paint.strokeStyle = paint.fillStyle = strong ? "#ffffff" : this.colour(n);
    paint.lineWidth = strong ? 2.5 : 1;
    paint.beginPath();
    paint.moveTo(...from);
    paint.lineTo(...to);
    paint.stroke();
    for (const [x, y] of [from, to]) {
      paint.beginPath();
      paint.arc(x, y, strong ? 5 : 2, 0, 7);
      paint.fill();
    }
    paint.globalAlpha = 1;
  }

  /** The lines of the pointer's epipolar plane in both images. */
  drawEpipolar(paint, height) {
    const [image, x, y] = this.pointer;
    const F = this.result.F;
    const transposed = F[0].map((_, column) => F.map((row) => row[column]));
    const matrix = image === 0 ? F : transposed; // to lines of the other image
    const epipole = nullVector(matrix); // of this image
    this.drawLine(paint, image, cross([x, y, 1], epipole), height);
    this.drawLine(paint, 1 - image, apply(matrix, [x, y, 1]), height);
    const [px, py] = this.place(image, x, y);
    paint.strokeStyle = "#000";
    paint.fillStyle = EPIPOLAR;
    paint.lineWidth = 1;
    paint.beginPath();
    paint.arc(px, py, 4.5, 0, 7);
    paint.fill();
    paint.stroke();
  }

  /** A line a x + b y + c = 0 across its image. */
  drawLine(paint, image, [a, b, c], height) {
    const norm = Math.hypot(a, b);
    if (!(norm > 0)) return; // the point is the epipole
    const [width, tall] = this.result.sizes[image];
    const foot = [-a * c / norm ** 2, -b * c / norm ** 2];
    const far = Math.hypot(...foot) + width + tall;
    const along = [b / norm * far, -a / norm * far];
    paint.save();
    paint.beginPath();
    paint.rect(this.size[image][0], 0, this.size[image][1] - this.size[image][0], height);
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

  point(event) {
    if (!this.places) return;
    const box = this.canvas.getBoundingClientRect();
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    const image = this.size.findIndex(([low, high]) => low <= x && x <= high);
    if (image < 0) {
      this.pointer = null;
    } else {
      const { left, scale } = this.places[image];
      this.pointer = [image, (x - left) / scale - 0.5, y / scale - 0.5];
    }
    this.draw();
  }

  /** The match that the pointer is at, of those drawn; null for none. */
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

  describe(nearest) {
    if (!this.pointer) {
      this.text.textContent = this.result.F
        ? "Point at an image: the epipolar lines of that point appear in both."
        : "There is no pose, so there are no epipolar lines.";
      return;
    }
    const [image, x, y] = this.pointer;
    let text = `image ${image + 1}, pixel ${x.toFixed(1)}, ${y.toFixed(1)}`;
    if (nearest !== null) {
      const { points, residual, confidence, inlier } = this.result.matches;
      const [x1, y1, x2, y2] = points[nearest];
      text = `match (${x1}, ${y1}) — (${x2}, ${y2}), confidence ${confidence[nearest]}`;
      if (residual[nearest] !== null) text += `, residual ${residual[nearest]} px`;
      text += inlier[nearest] ? ", inlier" : ", outlier";
    }
    this.text.textContent = text;
  }
}

/** Image 2 with the warped image 1 over it, or with the matchability. share: of the upper one. */
export function drawMap(canvas, second, warp, matchability, share) {
  if (!warp) return;
  const [paint, width, height] = prepared(canvas, second.naturalHeight / second.naturalWidth);
  paint.drawImage(second, 0, 0, width, height);
  paint.globalAlpha = share;
  paint.drawImage(matchability ?? warp, 0, 0, width, height);
  paint.globalAlpha = 1;
}

/** Bars of the residuals, outliers on top of inliers; the last one holds all that are larger.
    tall: height in CSS pixels; 0 for any. */
export function drawHistogram(canvas, { residual, inlier }, tall) {
  const [paint, width, height] = prepared(canvas, (tall || 0.62 * canvas.clientWidth) / canvas.clientWidth);
  const known = residual.map((value, n) => [value, inlier[n]]).filter(([value]) => value !== null);
  paint.font = "13px system-ui, sans-serif";
  paint.fillStyle = "#5b6875";
  if (!known.length) {
    paint.fillText("no residuals without a pose", 8, 24);
    return;
  }
  const sorted = known.filter(([, fits]) => fits).map(([value]) => value).sort((a, b) => a - b);
  const quantile = sorted.length ? sorted[Math.floor(0.95 * (sorted.length - 1))] : 1;
  const most = Math.max(0.01, 2 * quantile);
  const bars = Array.from({ length: 30 }, () => [0, 0]);
  for (const [value, fits] of known) bars[Math.min(29, Math.floor(30 * value / most))][fits ? 0 : 1]++;
  const tallest = Math.max(...bars.map(([inliers, outliers]) => inliers + outliers));
  const [left, bottom, room] = [44, height - 24, height - 34];
  const step = (width - left - 8) / 30;
  bars.forEach(([inliers, outliers], n) => {
    const [low, high] = [room * inliers / tallest, room * outliers / tallest];
    paint.fillStyle = INLIER;
    paint.fillRect(left + n * step, bottom - low, step - 1, low);
    paint.fillStyle = OUTLIER;
    paint.fillRect(left + n * step, bottom - low - high, step - 1, high);
  });
  paint.fillStyle = "#5b6875";
  paint.fillRect(left, bottom, width - left - 8, 1);
  paint.textAlign = "right";
  paint.fillText(String(tallest), left - 6, bottom - room + 8);
  paint.fillText("0", left - 6, bottom);
  paint.fillText(`${most.toFixed(2)} px or more`, width - 8, height - 6);
  paint.textAlign = "left";
  paint.fillText("0", left, height - 6);
}

function apply(matrix, vector) {
  return matrix.map((row) => row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2]);
}

function cross([a, b, c], [d, e, f]) {
  return [b * f - c * e, c * d - a * f, a * e - b * d];
}

/** The vector that a matrix of rank 2 takes to 0: across the two rows that are least parallel. */
function nullVector([row1, row2, row3]) {
  const vectors = [cross(row1, row2), cross(row2, row3), cross(row3, row1)];
  return vectors.reduce((best, vector) => (Math.hypot(...vector) > Math.hypot(...best) ? vector : best));
}
