// Cameras and points in space (x right, y down, z forward); mouse, fingers and keys move the view.
import { colour, prepared } from "./canvas.js";

const VIEWS = { aslant: [-35, 25], above: [0, 89], behind: [0, 0] }; // azimuth and elevation, degrees
const ROOM = 80; // margins around the drawing, CSS pixels, both sides together
const CLOSEST = 2.2; // largest initial zoom, over that of a ball around the scene, which may turn
const FAR = 2.6; // distance of the eye from the middle, in radii of the scene
const STEP = 6; // degrees that an arrow key turns
const KEYS = { ArrowLeft: [STEP, 0], ArrowRight: [-STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP] };
const ZOOMS = { "+": 1.15, "=": 1.15, "-": 1 / 1.15 };
const PYRAMID = [1, 2, 3, 4, 1, 0, 2, 3, 0, 4]; // a line through a camera's corners and centre (0)
const QUICK = 5000; // points drawn while the view moves
const REST = 200; // milliseconds of rest after which all points are drawn

export class Scene {
  /** fullPage: whether the scene fills the page and shows photographs. */
  constructor(canvas, fullPage = false) {
    Object.assign(this, { canvas, fullPage, points: null, names: true, photographs: fullPage });
    this.fingers = new Map(); // positions of pressed pointers, by identifier
    canvas.addEventListener("pointerdown", (event) => {
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
      button.addEventListener("click", () => this.lookFrom(button.dataset.from));
    }
  }

  /** Show cameras and points in random order; null for an empty scene. A camera has its centre and
      then its corners from the top left on, a label and a photograph. */
  show(content) {
    this.points = content?.points ?? null;
    if (!content) return;
    this.cameras = content.cameras;
    this.rejected = content.rejected ?? []; // rejected pairs of cameras, joined by dashes
    this.styles = this.points.rgb.map((rgb) => `rgb(${rgb})`);
    this.all = [...this.points.xyz, ...this.cameras.flatMap((camera) => camera.corners)];
    const ranges = [0, 1, 2].map((axis) => range(this.all, axis));
    this.middle = ranges.map(([low, high]) => (low + high) / 2);
    this.radius = Math.hypot(...ranges.map(([low, high]) => high - low)) / 2;
    this.lookFrom("aslant", false);
  }

  /** Show the scene from one of `VIEWS`. */
  lookFrom(name, drawn = true) {
    [this.azimuth, this.elevation] = VIEWS[name];
    const places = this.all.map(this.projection(0, 0, 1));
    const ranges = [0, 1].map((axis) => range(places, axis));
    this.extent = ranges.map(([low, high]) => Math.max(high - low, 2 / FAR / CLOSEST));
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
    places.forEach((corners, n) => things.push([0, 0, (corners[1][2] + corners[3][2]) / 2, n, corners]));
    things.sort((a, b) => b[2] - a[2]); // farthest first
    const size = FAR * this.radius * Math.max(2, width / Math.min(500, Math.max(160, 4 * Math.sqrt(xyz.length))));
    const pair = places.length === 2;
    const style = (n) => (pair && n ? "camera2" : "camera1");
    if (pair) stroke(paint, colour("soft"), 1, places.map(([centre]) => centre));
    paint.setLineDash([4, 4]);
    for (const ends of this.rejected) stroke(paint, colour("bad"), 1, ends.map((n) => places[n][0]));
    paint.setLineDash([]);
    for (const [x, y, depth, thing, corners] of things) {
      if (corners) {
        if (this.photographs) lay(paint, this.cameras[thing].photograph, corners);
        stroke(paint, colour(style(thing)), pair ? 2 : 1.5, PYRAMID.map((n) => corners[n]));
      } else {
        const side = Math.round(Math.min(8, size / depth)); // whole pixels are drawn faster
        paint.fillStyle = this.styles[thing];
        paint.fillRect(Math.round(x - side / 2), Math.round(y - side / 2), side, side);
      }
    }
    if (!this.names) return;
    // A label stands beside its camera's centre, away from the other cameras.
    const middle = [0, 1].map((axis) => places.reduce((sum, [centre]) => sum + centre[axis] / places.length, 0));
    Object.assign(paint, { textAlign: "center", textBaseline: "middle", lineWidth: 3, strokeStyle: colour("shade") });
    paint.font = `${pair ? "bold 15px" : "12px"} system-ui, sans-serif`;
    places.forEach(([[x, y]], n) => {
      const far = 14 / (Math.hypot(x - middle[0], y - middle[1]) || 1);
      const place = [x + far * (x - middle[0]), y + far * (y - middle[1])];
      paint.strokeText(this.cameras[n].label, ...place);
      paint.fillStyle = colour(style(n));
      paint.fillText(this.cameras[n].label, ...place);
    });
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

function stroke(paint, style, thick, places) {
  paint.strokeStyle = style;
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
