// What all drawings share.

/** An image of an address, decoded; null for none. */
export async function picture(url) {
  if (!url) return null;
  const image = new Image();
  image.src = url;
  await image.decode();
  return image;
}

/** A canvas as wide as it is shown and of this height; its context, width and height, CSS pixels. */
export function prepared(canvas, height) {
  const width = canvas.clientWidth;
  canvas.style.height = `${height}px`;
  canvas.width = Math.round(width * devicePixelRatio);
  canvas.height = Math.round(height * devicePixelRatio);
  const paint = canvas.getContext("2d");
  paint.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
  return [paint, width, height];
}

/** The residuals of the inliers in order, and the one that 95 % of them do not exceed; undefined
    without any. */
export function inlierResiduals({ residual, inlier }) {
  const sorted = residual.filter((value, n) => value !== null && inlier[n]).sort((a, b) => a - b);
  return [sorted, sorted[Math.floor(0.95 * (sorted.length - 1))]];
}

/** A colour of the style sheet, light or dark as the page is. */
export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}
