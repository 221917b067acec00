// Both cameras and the points between them, in camera 1's axes (x right, y down, z forward), seen
// from a place that mouse, fingers and keys move.
import { colour, prepared } from "./canvas.js";

const VIEWS = { aslant: [-35, 25], above: [0, 89], behind: [0, 0] }; // azimuth and elevation, degrees
const FRUSTUM = 0.18; // depth of a camera's pyramid, as a share of the median depth of the points
const MARGIN = 1.15; // around what is drawn
const CLOSEST = 1.6; // than a ball around all, at most: turned, more would leave the canvas
const FAR = 2.6; // of the eye from the middle, in radii of what is drawn
const STEP = 6; // degrees that an arrow key turns
const KEYS = { ArrowLeft: [STEP, 0], ArrowRight: [-STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP] };
const ZOOMS = { "+": 1.15, "=": 1.15, "-": 1 / 1.15 };
const EDGES = [[0, 1], [0, 2], [0, 3], [0, 4], [1, 2], [2, 3], [3, 4], [4, 1]];

export class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    this.points = null;
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
      if (document.activeElement !== canvas) return; // the wheel scrolls the page
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

  /** The cameras and the points of a result; nothing without a pose. */
  show({ pose, points, sizes }) {
    this.points = null;
    if (!points || !pose.t) return;
    const depths = points.xyz.map(([, , z]) => z).sort((a, b) => a - b);
    const depth = FRUSTUM * (depths[Math.floor(depths.length / 2)] ?? 2);
    const first = frustum(pose.camera1.K, sizes[0], depth);
    const second = frustum(pose.camera2.K, sizes[1], depth).map((point) => intoCamera1(point, pose));
    this.cameras = [first, second];
    this.points = points;
    this.all = [...points.xyz, ...first, ...second];
    const axes = [0, 1, 2].map((axis) => this.all.map((point) => point[axis]));
    const bounds = axes.map((values) => [values.reduce((a, b) => Math.min(a, b)), values.reduce((a, b) => Math.max(a, b))]);
    this.middle = bounds.map(([low, high]) => (low + high) / 2);
    this.radius = Math.hypot(...bounds.map(([low, high]) => high - low)) / 2;
    this.lookFrom("aslant", false);
  }

  /** See it from one of `VIEWS`. */
  lookFrom(name, drawn = true) {
    [this.azimuth, this.elevation] = VIEWS[name];
    this.zoom = 1;
    const places = this.all.map(this.projection(0, 0, 1));
    const most = [0, 1].map((axis) => places.reduce((far, place) => Math.max(far, Math.abs(place[axis])), 0));
    this.extent = most.map((far) => MARGIN * Math.max(far, 1 / FAR / CLOSEST));
    if (drawn) this.draw();
  }

  turn(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = Math.min(89, Math.max(-89, this.elevation + elevation));
    this.draw();
  }

  zoomBy(factor) {
    this.zoom = Math.min(20, Math.max(0.3, this.zoom * factor));
    this.draw();
  }

  /** One pointer turns, two zoom. */
  drag(event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    this.fingers.set(event.pointerId, now);
    if (this.fingers.size === 1) {
      this.turn((before[0] - now[0]) * 0.4, (now[1] - before[1]) * 0.4);
    } else {
      const [, other] = [...this.fingers].find(([finger]) => finger !== event.pointerId);
      const apart = (place) => Math.hypot(place[0] - other[0], place[1] - other[1]) || 1;
      this.zoomBy(apart(now) / apart(before));
    }
  }

  draw() {
    if (!this.points) return;
    const wide = this.canvas.clientWidth;
    const [paint, width, height] = prepared(this.canvas, Math.round(Math.min(0.8 * wide, Math.max(280, 0.7 * innerHeight))));
    const [across, down] = this.extent;
    const seen = this.projection(width / 2, height / 2, this.zoom * Math.min(width / across, height / down) / 2);
    const dots = this.points.xyz.map((point, n) => [...seen(point), this.points.rgb[n]]);
    dots.sort((a, b) => b[2] - a[2]); // the far ones first
    const size = Math.max(2, width / (dots.length < 1200 ? 160 : 220));
    for (const [x, y, depth, [red, green, blue]] of dots) {
      if (depth <= 0) continue;
      const side = Math.min(8, size * FAR * this.radius / depth);
      paint.fillStyle = `rgb(${red}, ${green}, ${blue})`;
      paint.fillRect(x - side / 2, y - side / 2, side, side);
    }
    const centres = this.cameras.map(([centre]) => seen(centre));
    this.line(paint, ...centres, colour("soft"), 1);
    this.cameras.forEach((corners, n) => {
      const places = corners.map(seen);
      const style = colour(`camera${n + 1}`);
      for (const [from, to] of EDGES) this.line(paint, places[from], places[to], style, 2);
      // The number stands beyond the centre, away from the other camera.
      const [x, y] = centres[n];
      const away = [x - centres[1 - n][0], y - centres[1 - n][1]];
      const far = 14 / (Math.hypot(...away) || 1);
      paint.font = "bold 15px system-ui, sans-serif";
      paint.textAlign = "center";
      paint.textBaseline = "middle";
      paint.lineWidth = 3;
      paint.strokeStyle = colour("shade");
      paint.strokeText(n + 1, x + far * away[0], y + far * away[1]);
      paint.fillStyle = style;
      paint.fillText(n + 1, x + far * away[0], y + far * away[1]);
    });
  }

  line(paint, from, to, style, thick) {
    if (from[2] <= 0 || to[2] <= 0) return; // behind the eye
    paint.strokeStyle = style;
    paint.lineWidth = thick;
    paint.beginPath();
    paint.moveTo(from[0], from[1]);
    paint.lineTo(to[0], to[1]);
    paint.stroke();
  }

  /** A function of points: their places on the canvas, and the distance from the eye's plane. x, y: of
      the middle. */
  projection(x0, y0, scale) {
    const [azimuth, elevation] = [this.azimuth, this.elevation].map((angle) => angle * Math.PI / 180);
    const [sa, ca, se, ce] = [Math.sin(azimuth), Math.cos(azimuth), Math.sin(elevation), Math.cos(elevation)];
    const far = FAR * this.radius;
    return (point) => {
      const [x, y, z] = point.map((value, axis) => value - this.middle[axis]);
      const [right, ahead] = [ca * x + sa * z, ca * z - sa * x];
      const [down, deep] = [ce * y - se * ahead, ce * ahead + se * y + far];
      return [x0 + scale * right / deep, y0 + scale * down / deep, deep];
    };
  }
}

/** The centre and the four corners of a camera's view at a depth, in its axes. */
function frustum([[fx, skew, cx], [, fy, cy]], [width, height], depth) {
  const corners = [[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]];
  return [[0, 0, 0], ...corners.map(([x, y]) => {
    const down = (y - cy) / fy;
    return [depth * (x - cx - skew * down) / fx, depth * down, depth];
  })];
}

/** A point of camera 2's axes in those of camera 1: R^T (x2 - t). */
function intoCamera1(point, { R, t }) {
  const rest = point.map((value, axis) => value - t[axis]);
  return [0, 1, 2].map((axis) => R[0][axis] * rest[0] + R[1][axis] * rest[1] + R[2][axis] * rest[2]);
}
