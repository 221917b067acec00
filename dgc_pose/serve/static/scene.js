// Cameras and points in space (x right, y down, z forward), seen from a place that mouse, fingers and
// keys move.
import { colour, prepared } from "./canvas.js";

const VIEWS = { aslant: [-35, 25], above: [0, 89], behind: [0, 0] }; // azimuth and elevation, degrees
const MARGIN = 1.15; // around what is drawn
const CLOSEST = 2.2; // than a ball around all, at most: turned, more would leave the canvas
const FAR = 2.6; // of the eye from the middle, in radii of what is drawn
const STEP = 6; // degrees that an arrow key turns
const KEYS = { ArrowLeft: [STEP, 0], ArrowRight: [-STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP] };
const ZOOMS = { "+": 1.15, "=": 1.15, "-": 1 / 1.15 };
const FRUSTUM = [[1, 2, 3, 4, 1, 0, 2], [3, 0, 4]]; // lines through a camera's centre and its corners
const QUICK = 5000; // points drawn while it moves
const REST = 200; // milliseconds after which all of them are
const NEAR = 24; // CSS pixels of the pointer from a camera

export class Scene {
  /** alone: nothing else is on the page, so that the wheel needs no click first. */
  constructor(canvas, alone = false) {
    this.canvas = canvas;
    this.points = null;
    this.shown = { names: true, photographs: true, size: 1 }; // size: of the cameras
    this.fingers = new Map(); // places of the pointers that are down, by their identifiers
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.fingers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => this.fingers.delete(event.pointerId));
    }
    canvas.addEventListener("wheel", (event) => {
      if (!alone && document.activeElement !== canvas) return; // the wheel scrolls the page
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
  }

  /** Cameras, each with a centre, corners from the top left clockwise, a label, a colour of the style
      sheet and perhaps a picture; points in a random order; what `unit` they are in, if one is known. */
  show(content) {
    this.points = content?.points ?? null;
    if (!content) return;
    this.cameras = content.cameras.map((camera) => ({ ...camera, corners: [camera.centre, ...camera.corners] }));
    this.unit = content.unit;
    this.styles = this.points.rgb.map((rgb) => `rgb(${rgb})`);
    this.all = [...this.points.xyz, ...this.cameras.flatMap((camera) => camera.corners)];
    const ranges = [0, 1, 2].map((axis) => range(this.all, axis));
    this.middle = ranges.map(([low, high]) => (low + high) / 2);
    this.radius = Math.hypot(...ranges.map(([low, high]) => high - low)) / 2;
    this.lookFrom("aslant", false);
  }

  /** See it from one of `VIEWS`. */
  lookFrom(name, drawn = true) {
    [this.azimuth, this.elevation] = VIEWS[name];
    this.zoom = 1;
    this.shift = [0, 0];
    const places = this.all.map(this.projection(0, 0, 1));
    const ranges = [0, 1].map((axis) => range(places, axis));
    this.extent = ranges.map(([low, high]) => MARGIN * Math.max(high - low, 2 / FAR / CLOSEST));
    this.focus = ranges.map(([low, high]) => (low + high) / 2);
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

  /** One pointer turns, or moves the scene with Shift or the right button; two zoom and move it. None
      points at a camera. */
  drag(event) {
    const before = this.fingers.get(event.pointerId);
    const now = [event.clientX, event.clientY];
    if (!before) return this.point(event.offsetX, event.offsetY);
    this.fingers.set(event.pointerId, now);
    const [right, down] = [now[0] - before[0], now[1] - before[1]];
    const alone = this.fingers.size === 1;
    if (alone && !event.shiftKey && !(event.buttons & 2)) return this.turn(-0.4 * right, 0.4 * down);
    const share = this.zoom * this.fingers.size;
    this.shift = [this.shift[0] + right / share, this.shift[1] + down / share];
    const [, other] = [...this.fingers].find(([finger]) => alone || finger !== event.pointerId);
    const apart = (place) => Math.hypot(place[0] - other[0], place[1] - other[1]) || 1;
    this.zoomBy(alone ? 1 : apart(now) / apart(before));
  }

  /** The camera nearest to a place of the canvas; -1 for none. */
  point(x, y) {
    const far = this.cameras.map(({ at }) => Math.hypot(at[0] - x, at[1] - y));
    const nearest = far.indexOf(Math.min(...far, NEAR));
    if (nearest !== this.pointed) this.drawSoon();
    this.pointed = nearest;
  }

  /** A part of the points in the next frame, all of them when it rests. */
  drawSoon() {
    cancelAnimationFrame(this.frame);
    clearTimeout(this.rest);
    this.frame = requestAnimationFrame(() => this.draw(QUICK));
    this.rest = setTimeout(() => this.draw(), REST);
  }

  /** The canvas's height at a width, CSS pixels. */
  height(width) {
    return Math.round(Math.min(0.8 * width, Math.max(280, 0.7 * innerHeight)));
  }

  draw(most = Infinity) {
    if (!this.points) return;
    const [paint, width, height] = prepared(this.canvas, this.height(this.canvas.clientWidth));
    const scale = this.zoom * Math.min(width / this.extent[0], height / this.extent[1]);
    const [x0, y0] = [width, height].map((side, n) => side / 2 + this.zoom * this.shift[n] - scale * this.focus[n]);
    const seen = this.projection(x0, y0, scale);
    const { xyz } = this.points;
    const things = []; // places with the number of a point, or with a camera
    for (let n = 0; n < xyz.length; n += Math.max(1, Math.ceil(xyz.length / most))) things.push([...seen(xyz[n]), n]);
    for (const camera of this.cameras) {
      const grown = (point) => point.map((value, n) => camera.centre[n] + this.shown.size * (value - camera.centre[n]));
      camera.places = camera.corners.map((point) => seen(grown(point)));
      camera.at = [0, 1, 2].map((axis) => camera.places.slice(1).reduce((sum, place) => sum + place[axis] / 4, 0));
      things.push([...camera.at, camera]);
    }
    things.sort((a, b) => b[2] - a[2]); // the far ones first
    const size = Math.max(2, width / Math.min(500, Math.max(160, 4 * Math.sqrt(xyz.length))));
    const ends = this.cameras.map(({ places }) => places[0]);
    if (ends.length === 2) stroke(paint, colour("soft"), 1, [ends]);
    for (const [x, y, depth, thing] of things) {
      if (typeof thing === "object") {
        if (thing.picture && this.shown.photographs) lay(paint, thing.picture, thing.places.slice(1));
        const lines = FRUSTUM.map((line) => line.map((n) => thing.places[n]));
        stroke(paint, colour(thing.colour), thing === this.cameras[this.pointed] ? 4 : ends.length === 2 ? 2 : 1.5, lines);
      } else {
        const side = Math.round(Math.min(8, size * FAR * this.radius / depth)); // whole pixels are drawn fast
        paint.fillStyle = this.styles[thing];
        paint.fillRect(Math.round(x - side / 2), Math.round(y - side / 2), side, side);
      }
    }
    // A name stands beyond the centre, away from the other cameras.
    const [left, top] = [0, 1].map((axis) => ends.reduce((sum, end) => sum + end[axis], 0) / ends.length);
    paint.font = ends.length === 2 ? "bold 15px system-ui, sans-serif" : "12px system-ui, sans-serif";
    paint.textAlign = "center";
    paint.textBaseline = "middle";
    paint.lineWidth = 3;
    paint.strokeStyle = colour("shade");
    this.cameras.forEach(({ label, colour: name }, n) => {
      if (!this.shown.names && n !== this.pointed) return;
      const [x, y] = ends[n];
      const far = 14 / (Math.hypot(x - left, y - top) || 1);
      paint.fillStyle = colour(name);
      for (const how of ["strokeText", "fillText"]) paint[how](label, x + far * (x - left), y + far * (y - top));
    });
    if (this.unit) this.drawScale(paint, scale / FAR / this.radius, height);
  }

  /** A bar of 1, 2 or 5 times a power of ten, as long as it is at the middle. */
  drawScale(paint, pixels, height) {
    const power = 10 ** Math.floor(Math.log10(200 / pixels));
    const length = power * [5, 2, 1].find((times) => times * power * pixels <= 200);
    const [x, y] = [16 + length * pixels, height - 16];
    stroke(paint, colour("ink"), 2, [[[16, y - 5], [16, y], [x, y], [x, y - 5]]]);
    paint.fillStyle = colour("ink");
    paint.textAlign = "left";
    paint.fillText(`${length} ${this.unit}`, 16, y - 14);
  }

  /** A function of points: their places on the canvas, and the distance from the eye's plane. x, y: of
      the middle. */
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

/** The least and the largest coordinate of points along an axis. */
function range(points, axis) {
  const values = points.map((point) => point[axis]);
  return [values.reduce((a, b) => Math.min(a, b)), values.reduce((a, b) => Math.max(a, b))];
}

function stroke(paint, style, thick, lines) {
  paint.strokeStyle = style;
  paint.lineWidth = thick;
  paint.beginPath();
  for (const line of lines) line.forEach(([x, y], n) => (n ? paint.lineTo(x, y) : paint.moveTo(x, y)));
  paint.stroke();
}

/** A picture on four places, from the top left clockwise: a triangle over an affine map of the whole. */
function lay(paint, picture, [a, b, c, d]) {
  const opposite = [0, 1].map((axis) => b[axis] + d[axis] - c[axis]); // where c's triangle has a
  for (const [inside, origin, right, down] of [[[a, b, c, d], a, b, d], [[b, c, d], opposite, b, d]]) {
    paint.save();
    paint.beginPath();
    inside.forEach(([x, y]) => paint.lineTo(x, y));
    paint.clip();
    const along = [right, down].flatMap((end, n) => [0, 1].map((axis) => (end[axis] - origin[axis]) / [picture.width, picture.height][n]));
    paint.transform(...along, origin[0], origin[1]);
    paint.drawImage(picture, 0, 0);
    paint.restore();
  }
}
