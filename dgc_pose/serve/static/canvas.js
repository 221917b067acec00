// Functions that all drawings share.

/** The decoded image of a URL; null without a URL. */
export async function picture(url) {
  if (!url) return null;
  const image = new Image();
  image.src = url;
  await image.decode();
  return image;
}

/** Size a canvas to its shown width and this height. Its context, width and height, CSS pixels. */
export function prepared(canvas, height) {
  const width = canvas.clientWidth;
  canvas.style.height = `${height}px`;
  canvas.width = Math.round(width * devicePixelRatio);
  canvas.height = Math.round(height * devicePixelRatio);
  const paint = canvas.getContext("2d");
  paint.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
  return [paint, width, height];
}

/** The sorted residuals of the inliers, and their 95th percentile, which is undefined without
    residuals. */
export function inlierResiduals({ residual, inlier }) {
  const sorted = residual.filter((value, n) => value !== null && inlier[n]).sort((a, b) => a - b);
  return [sorted, sorted[Math.floor(0.95 * (sorted.length - 1))]];
}

/** A colour of the style sheet, for the light or dark page. */
export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}
