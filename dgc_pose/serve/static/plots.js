// The map over image 2, and the histogram of the residuals.
import { colour, inlierResiduals, prepared } from "./canvas.js";

const TALL = 180; // height of the histogram, CSS pixels
const BARS = 40;

/** Draw image 2 under the warped image 1 or under the matchability. share: opacity of the upper. */
export function drawMap(canvas, second, warp, matchability, share) {
  if (!warp) return;
  const aspect = second.naturalHeight / second.naturalWidth;
  const tall = Math.min(aspect * canvas.clientWidth, Math.max(320, 0.85 * innerHeight));
  const [paint, width, height] = prepared(canvas, Math.round(tall));
  const wide = Math.min(width, height / aspect);
  const place = [(width - wide) / 2, 0, wide, height];
  paint.drawImage(second, ...place);
  paint.globalAlpha = share;
  paint.drawImage(matchability ?? warp, ...place);
  paint.globalAlpha = 1;
}

/** Draw a histogram of residuals, outliers on top of inliers; the last bar has all larger ones. */
export function drawHistogram(canvas, { residual, inlier }) {
  const [paint, width, height] = prepared(canvas, TALL);
  const known = residual.map((value, n) => [value, inlier[n]]).filter(([value]) => value !== null);
  const [, nearlyAll = 1] = inlierResiduals({ residual, inlier });
  const most = Math.max(0.01, 2 * nearlyAll);
  const bars = Array.from({ length: BARS }, () => [0, 0]);
  for (const [value, fits] of known) bars[Math.min(BARS - 1, Math.floor(BARS * value / most))][fits ? 0 : 1]++;
  const tallest = Math.max(1, ...bars.map(([inliers, outliers]) => inliers + outliers));
  const [left, bottom, room] = [44, height - 24, height - 34];
  const step = (width - left - 8) / BARS;
  const colours = [colour("inlier"), colour("outlier")];
  bars.forEach(([inliers, outliers], n) => {
    const [low, high] = [room * inliers / tallest, room * outliers / tallest];
    paint.fillStyle = colours[0];
    paint.fillRect(left + n * step, bottom - low, step - 1, low);
    paint.fillStyle = colours[1];
    paint.fillRect(left + n * step, bottom - low - high, step - 1, high);
  });
  paint.font = "13px system-ui, sans-serif";
  paint.fillStyle = colour("soft");
  paint.fillRect(left, bottom, width - left - 8, 1);
  paint.textAlign = "right";
  paint.fillText(String(tallest), left - 6, bottom - room + 8);
  paint.fillText("0", left - 6, bottom);
  paint.fillText(`${most.toFixed(2)} px or more`, width - 8, height - 6);
  paint.textAlign = "left";
  paint.fillText("0", left, height - 6);
}
