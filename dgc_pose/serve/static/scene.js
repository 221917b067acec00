// Cameras and points in space (x right, y down, z forward); mouse, fingers and keys move the view.
import { colour, prepared } from "./canvas.js";

const VIEWS = { aslant: [-35, 25], above: [0, 89], behind: [0, 0] }; // azimuth and elevation, degrees
const ROOM = 80; // margins around the drawing, CSS pixels, both sides together
const CLOSEST = 2.2; // largest initial zoom, over that of a ball around what is framed, which may turn
const FAR = 2.6; // distance of the eye from the middle, in radii of the scene
const STEP = 6; // degrees that an arrow key turns
const KEYS = { ArrowLeft: [STEP, 0], ArrowRight: [-STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP] };
const ZOOMS = { "+": 1.15, "=": 1.15, "-": 1 / 1.15 };
const PYRAMID = [1, 2, 3, 4, 1, 0, 2, 3, 0, 4]; // a line through a camera's corners and centre (0)
const FACES = [[1, 2, 3, 4], [0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]];
const LOOKS = { // by the kind of a camera: the style sheet's colour, thickness of the lines, font of the name
  photograph: ["camera1", 1.5, "12px"],
  first: ["camera1", 2, "bold 15px"],
  second: ["camera2", 2, "bold 15px"],
  fixed: ["camera1", 2.5, "bold 15px"],
  walk: ["camera2", 1, "12px"],
};
const NAMED = ["first", "second", "fixed"]; // kinds that have a name in any case
const SHIFTS = [0, -1, 1, -2, 2]; // of a name where others are in its way, in lines
const LINE = 20; // height of a name, CSS pixels
const NEAR = 12; // a click this near to a line of a camera hits it, CSS pixels: a finger is wide
const STILL = 5; // a pointer that moves less between down and up clicks, CSS pixels
const QUICK = 5000; // points drawn while the view moves
const REST = 200; // milliseconds of rest after which all points are drawn

export class Scene {
  /** fullPage: whether the scene fills the page and shows photographs. */
  constructor(canvas, fullPage = false) {
    Object.assign(this, { canvas, fullPage, points: null, names: true, photographs: fullPage, walk: true });
    this.chosen = -1; // number of the camera that stands out
    this.fingers = new Map(); // positions of pressed pointers, by identifier
    canvas.addEventListener("pointerdown", (event) => {
      if (!this.fingers.size) this.moved = 0; // by the pointers since the first was pressed, CSS pixels
      canvas.setPointerCapture(event.pointerId);
      this.fingers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => this.fingers.delete(event.pointerId));
    }
    canvas.addEventListener("wheel", (event) => {
      if (!(fullPage && window === top) && document.activeElement !== canvas) return; // let the wheel scroll
      event.preventDefault();
      this.zoomBy(Math.exp(-event.deltaY / 500));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.key in KEYS) this.turn(...KEYS[event.key]);
      else if (event.key in ZOOMS) this.zoomBy(ZOOMS[event.key]);
      else return;
      event.preventDefault();
    });
    for (const button of document.querySelectorAll("[data-from]")) {
      button.addEventListener("click", () => this.points && this.lookFrom(button.dataset.from));
    }
  }

  /** Show cameras and points in random order; null for an empty scene. A camera has its centre and
      then its corners from the top left on, a label and a photograph; those of a rig have a kind,
      "fixed" or "walk". */
  show(content) {
    this.points = content?.points ?? null;
    if (!content) return;
    this.cameras = content.cameras;
    this.kinds = this.cameras.map(({ kind }, n) => kind ?? (this.cameras.length === 2 ? ["first", "second"][n] : "photograph"));
    this.rejected = content.rejected ?? []; // rejected pairs of cameras, joined by dashes
    this.styles = this.points.rgb.map((rgb) => `rgb(${rgb})`);
    const corners = this.cameras.flatMap((camera) => camera.corners);
    this.framed = [...this.points.xyz, ...corners];
    if (this.kinds.includes("fixed")) this.framed = [...nearest(this.points.xyz, corners), ...corners];
    const ranges = [0, 1, 2].map((axis) => range(this.framed, axis));
    this.middle = ranges.map(([low, high]) => (low + high) / 2);
    const farthest = this.points.xyz.reduce((most, point) => Math.max(most, distance(point, this.middle)), 0);
    const half = Math.hypot(...ranges.map(([low, high]) => high - low)) / 2;
    this.radius = Math.max(half, farthest / 2); // the eye has all points ahead
    this.least = 2 * half / this.radius / FAR / CLOSEST; // of the drawing's width and height at scale 1
    this.lookFrom("aslant", false);
  }

  /** Let a camera stand out, by its number; -1 for none. */
  choose(number) {
    if (number === this.chosen) return;
    this.chosen = number;
    this.draw();
  }

  /** Whether the pointers have dragged since the first was pressed. */
  get dragged() {
    return this.moved > STILL;
  }

  /** The number of the camera at a mouse event on the canvas, of a rig fixed ones first, then near
      ones; -1 for none. */
  cameraAt({ offsetX, offsetY }) {
    const named = this.boxes.findIndex((box) => box && overlap(box, [offsetX, offsetY, offsetX, offsetY]));
    if (named >= 0) return named;
    const paint = this.canvas.getContext("2d");
    paint.lineWidth = 2 * NEAR;
    const spot = [offsetX * devicePixelRatio, offsetY * devicePixelRatio];
    const hit = this.shown.filter((n) => FACES.some((face) => {
      const outline = path(face.map((corner) => this.places[n][corner]));
      return paint.isPointInPath(outline, ...spot) || paint.isPointInStroke(outline, ...spot);
    }));
    const later = (n) => (this.kinds[n] === "walk" ? 1 : 0);
    hit.sort((a, b) => later(a) - later(b) || this.places[a][0][2] - this.places[b][0][2]);
    return hit[0] ?? -1;
  }

  /** Show the scene from one of `VIEWS`. */
  lookFrom(name, drawn = true) {
    [this.azimuth, this.elevation] = VIEWS[name];
    const places = this.framed.map(this.projection(0, 0, 1));
    const ranges = [0, 1].map((axis) => range(places, axis));
    this.extent = ranges.map(([low, high]) => Math.max(high - low, this.least));
    this.focus = ranges.map(([low, high]) => (low + high) / 2); // at the middle of the canvas
    this.zoom = 1;
    if (drawn) this.draw();
  }

  turn(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = Math.min(89, Math.max(-89, this.elevation + elevation));
    this.drawSoon();
  }

  zoomBy(factor) {
    this.zoom = Math.min(20, Math.max(0.3, this.zoom * factor));
    this.drawSoon();
  }

  /** One pointer turns the scene, or moves it with Shift; two pointers zoom. */
  drag(event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    this.fingers.set(event.pointerId, now);
    const by = [now[0] - before[0], now[1] - before[1]];
    this.moved += Math.hypot(...by);
    if (this.fingers.size > 1) {
      const [, other] = [...this.fingers].find(([finger]) => finger !== event.pointerId);
      const apart = (place) => Math.hypot(place[0] - other[0], place[1] - other[1]) || 1;
      this.zoomBy(apart(now) / apart(before));
    } else if (!event.shiftKey) return this.turn(-0.4 * by[0], 0.4 * by[1]);
    this.focus = this.focus.map((value, n) => value - by[n] / this.scale / this.fingers.size);
    this.drawSoon();
  }

  /** Draw some of the points in the next frame, and all of them once the view rests. */
  drawSoon() {
    cancelAnimationFrame(this.frame);
    clearTimeout(this.rest);
    this.frame = requestAnimationFrame(() => this.draw(QUICK));
    this.rest = setTimeout(() => this.draw(), REST);
  }

  draw(most = Infinity) {
    if (!this.points) return;
    const { clientWidth: wide, clientHeight: tall } = this.canvas;
    const room = this.fullPage ? tall : Math.round(Math.min(0.8 * wide, Math.max(280, 0.7 * innerHeight)));
    const [paint, width, height] = prepared(this.canvas, room);
    this.scale = this.zoom * Math.min((width - ROOM) / this.extent[0], (height - ROOM) / this.extent[1]);
    const seen = this.projection(width / 2 - this.scale * this.focus[0], height / 2 - this.scale * this.focus[1], this.scale);
    const { xyz } = this.points;
    const things = []; // [x, y, depth, index] of points; cameras also with their corners
    for (let n = 0; n < xyz.length; n += Math.ceil(xyz.length / most) || 1) things.push([...seen(xyz[n]), n]);
    const places = this.cameras.map((camera) => camera.corners.map(seen));
    this.places = places;
    this.shown = [...places.keys()].filter((n) => this.walk || this.kinds[n] !== "walk" || n === this.chosen);
    for (const n of this.shown) {
      const deep = n === this.chosen ? 0 : (places[n][1][2] + places[n][3][2]) / 2; // the chosen one covers the others
      things.push([0, 0, deep, n, places[n]]);
    }
    things.sort((a, b) => b[2] - a[2]); // farthest first
    const size = FAR * this.radius * Math.max(2, width / Math.min(500, Math.max(160, 4 * Math.sqrt(xyz.length))));
    if (this.kinds[0] === "first") stroke(paint, colour("soft"), 1, places.map(([centre]) => centre));
    paint.setLineDash([4, 4]);
    for (const ends of this.rejected) stroke(paint, colour("bad"), 1, ends.map((n) => places[n][0]));
    paint.setLineDash([]);
    paint.imageSmoothingQuality = "high";
    for (const [x, y, depth, thing, corners] of things) {
      if (corners) {
        const kind = this.kinds[thing];
        const [style, thick] = LOOKS[kind];
        const line = PYRAMID.map((n) => corners[n]);
        if (thing === this.chosen) stroke(paint, colour("ink"), thick + 4, line);
        if (this.fullPage && (this.photographs || kind === "fixed")) lay(paint, this.cameras[thing].photograph, corners);
        stroke(paint, colour(style), thick, line);
      } else {
        const side = Math.round(Math.min(8, size / depth)); // whole pixels are drawn faster
        paint.fillStyle = this.styles[thing];
        paint.fillRect(Math.round(x - side / 2), Math.round(y - side / 2), side, side);
      }
    }
    this.drawNames(paint, width, height);
  }

  /** Write names of cameras: beside the centre, away from the other cameras, or of a rig above the
      pyramid. A name without a free place is left out. */
  drawNames(paint, width, height) {
    const middle = [0, 1].map((axis) => this.places.reduce((sum, [centre]) => sum + centre[axis] / this.places.length, 0));
    const first = (n) => n === this.chosen || NAMED.includes(this.kinds[n]);
    const named = this.shown.filter((n) => this.names || first(n)).sort((a, b) => first(b) - first(a));
    this.boxes = []; // left, top, right and bottom of the names that are drawn, by the camera's number
    Object.assign(paint, { textAlign: "center", textBaseline: "middle", lineWidth: 3, strokeStyle: colour("shade") });
    for (const n of named) {
      const kind = this.kinds[n];
      const [style, , font] = LOOKS[kind];
      const { label } = this.cameras[n];
      paint.font = `${n === this.chosen ? "bold 15px" : font} system-ui, sans-serif`;
      const wide = paint.measureText(label).width + 6;
      const [x, y] = kind === "fixed" || kind === "walk" ? above(this.places[n]) : beside(this.places[n][0], middle, wide / 2);
      const boxes = SHIFTS.map((shift) => {
        const left = Math.max(0, Math.min(width - wide, x - wide / 2));
        const top = Math.max(0, Math.min(height - LINE, y + (shift - 0.5) * LINE));
        return [left, top, left + wide, top + LINE];
      });
      const free = boxes.find((box) => !this.boxes.some((other) => other && overlap(box, other)));
      const box = free ?? (n === this.chosen ? boxes[0] : null);
      if (!box) continue;
      this.boxes[n] = box;
      paint.strokeText(label, box[0] + wide / 2, box[1] + LINE / 2);
      paint.fillStyle = colour(style);
      paint.fillText(label, box[0] + wide / 2, box[1] + LINE / 2);
    }
  }

  /** A function from a point to its place on the canvas and its depth. x0, y0: place of the scene's
      middle. */
  projection(x0, y0, scale) {
    const [azimuth, elevation] = [this.azimuth, this.elevation].map((angle) => angle * Math.PI / 180);
    const [sa, ca, se, ce] = [Math.sin(azimuth), Math.cos(azimuth), Math.sin(elevation), Math.cos(elevation)];
    const far = FAR * this.radius;
    const [x1, y1, z1] = this.middle;
    return (point) => {
      const [x, y, z] = [point[0] - x1, point[1] - y1, point[2] - z1];
      const [right, ahead] = [ca * x + sa * z, ca * z - sa * x];
      const [down, deep] = [ce * y - se * ahead, ce * ahead + se * y + far];
      return [x0 + scale * right / deep, y0 + scale * down / deep, deep];
    };
  }
}

/** The smallest and largest coordinate of points along an axis. */
function range(points, axis) {
  return points.reduce(([low, high], point) => [Math.min(low, point[axis]), Math.max(high, point[axis])], [Infinity, -Infinity]);
}

function distance(one, two) {
  return Math.hypot(...one.map((value, axis) => value - two[axis]));
}

/** The third of the points that is nearest to the middle of the corners. */
function nearest(points, corners) {
  const middle = [0, 1, 2].map((axis) => range(corners, axis).reduce((sum, end) => sum + end / 2, 0));
  const away = points.map((point) => distance(point, middle));
  const most = [...away].sort((a, b) => a - b)[Math.floor(away.length / 3)];
  return points.filter((point, n) => away[n] <= most);
}

/** Whether two boxes (left, top, right, bottom) have a common point. */
function overlap(one, two) {
  return one[0] <= two[2] && two[0] <= one[2] && one[1] <= two[3] && two[1] <= one[3];
}

/** The place of a name above a pyramid. */
function above(corners) {
  const [[left, right], [top]] = [0, 1].map((axis) => range(corners, axis));
  return [(left + right) / 2, top - LINE / 2 - 1];
}

/** The place of a name, `half` as wide, beside a camera's centre, away from the middle of all. */
function beside([x, y], middle, half) {
  const far = Math.hypot(x - middle[0], y - middle[1]) || 1;
  const [right, down] = [(x - middle[0]) / far, (y - middle[1]) / far];
  return [x + right * (half + 4), y + down * 14];
}

function path(places) {
  const outline = new Path2D();
  for (const [x, y] of places) outline.lineTo(x, y);
  outline.closePath();
  return outline;
}

function stroke(paint, style, thick, places) {
  paint.strokeStyle = style;
  paint.lineJoin = "round";
  paint.lineWidth = thick;
  paint.beginPath();
  for (const [x, y] of places) paint.lineTo(x, y);
  paint.stroke();
}

/** Draw a photograph onto a camera's corners: as two triangles, each by its own affine map. */
function lay(paint, photograph, [, a, b, c, d]) {
  const { width, height } = photograph;
  const opposite = [b[0] + d[0] - c[0], b[1] + d[1] - c[1]];
  for (const [[x, y], ...outline] of [[a, a, b, c, d], [opposite, b, c, d]]) {
    paint.save();
    paint.beginPath();
    for (const place of outline) paint.lineTo(place[0], place[1]);
    paint.clip();
    paint.transform((b[0] - x) / width, (b[1] - y) / width, (d[0] - x) / height, (d[1] - y) / height, x, y);
    paint.drawImage(photograph, 0, 0);
    paint.restore();
  }
}
