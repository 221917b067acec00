// The dense map on a grid of cells of image 2. Points are in pixels of the originals.

const MATCHABLE = 0.1; // a cell with less matchability has no point in image 1

export class Correspondences {
  /** The first argument is from the server; size1: width and height of image 1. */
  constructor({ columns, rows, first, last, points, matchability }, size1) {
    Object.assign(this, { columns, rows, first, points, matchability, size1 });
    this.step = [(last[0] - first[0]) / (columns - 1 || 1), (last[1] - first[1]) / (rows - 1 || 1)];
  }

  /** The point in image 1 for a pixel of image 2, and its matchability; null without a point. */
  inImage1(x, y) {
    // Bilinear between four cells; extrapolated in the outer half cell.
    const [u, v] = [(x - this.first[0]) / this.step[0], (y - this.first[1]) / this.step[1]];
    const column = Math.min(this.columns - 2, Math.max(0, Math.floor(u)));
    const row = Math.min(this.rows - 2, Math.max(0, Math.floor(v)));
    if (column < 0 || row < 0) return null;
    const [right, down] = [u - column, v - row];
    const corner = row * this.columns + column;
    const parts = [
      [corner, (1 - right) * (1 - down)],
      [corner + 1, right * (1 - down)],
      [corner + this.columns, (1 - right) * down],
      [corner + this.columns + 1, right * down],
    ];
    const mixed = (value) => parts.reduce((sum, [cell, share]) => sum + share * value(cell), 0);
    const matchability = Math.min(1, Math.max(0, mixed((cell) => this.matchability[cell])));
    const point = { x: mixed((cell) => this.points[cell][0]), y: mixed((cell) => this.points[cell][1]), matchability };
    return matchability >= MATCHABLE && this.isInside(point) ? point : null;
  }

  /** The point in image 2 for a pixel of image 1: the cell whose point is nearest, corrected by the
      slopes to its neighbours; null if no cell is near. */
  inImage2(x, y) {
    let [best, least] = [-1, Infinity];
    this.points.forEach(([px, py], cell) => {
      const distance = Math.hypot(px - x, py - y);
      if (distance < least && this.matchability[cell] >= MATCHABLE) [best, least] = [cell, distance];
    });
    if (best < 0) return null;
    const [row, column] = [Math.floor(best / this.columns), best % this.columns];
    const across = this.slope(best, column, this.columns, 1);
    const down = this.slope(best, row, this.rows, this.columns);
    const [restX, restY] = [x - this.points[best][0], y - this.points[best][1]];
    const determinant = across[0] * down[1] - across[1] * down[0];
    const cells = [
      (restX * down[1] - restY * down[0]) / determinant,
      (across[0] * restY - across[1] * restX) / determinant,
    ];
    if (!cells.every((value) => Math.abs(value) <= 1)) return null;
    return {
      x: this.first[0] + (column + cells[0]) * this.step[0],
      y: this.first[1] + (row + cells[1]) * this.step[1],
      matchability: this.matchability[best],
    };
  }

  /** The change of the map's point from cell to cell along one axis. */
  slope(cell, place, count, stride) {
    const [before, after] = [place > 0 ? cell - stride : cell, place < count - 1 ? cell + stride : cell];
    const apart = (after - before) / stride;
    return [0, 1].map((axis) => (this.points[after][axis] - this.points[before][axis]) / apart);
  }

  isInside({ x, y }) {
    return x >= -0.5 && y >= -0.5 && x <= this.size1[0] - 0.5 && y <= this.size1[1] - 0.5;
  }
}
