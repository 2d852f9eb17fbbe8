// Small line charts.

const LABELS = 52; // pixels, for labels on the right; the slider of style.css leaves them, too

/** A number with so many digits after the point, and a minus sign that is one. */
export const fixed = (value, digits) => value.toFixed(digits).replace("-", "−");

/**
 * @param {HTMLCanvasElement} canvas
 * @param {number[][]} points x, y, each in its range
 * @param {{x: number[], y: number[], color: string, zero?: string, mark?: number,
 *   labels?: string}} options
 *   zero: color of a line at 0; mark: x of a vertical line; labels: color of the lowest y, the
 *   highest and 0, written on the right
 */
export function drawLine(canvas, points, { x, y, color, zero, mark, labels }) {
  const ratio = Math.min(devicePixelRatio || 1, 2.5);
  const { clientWidth, clientHeight: height } = canvas, width = clientWidth - (labels ? LABELS : 0);
  Object.assign(canvas, { width: clientWidth * ratio, height: height * ratio });
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  const toX = (value) => ((value - x[0]) / (x[1] - x[0])) * width;
  const margin = labels ? 7 : 3;
  const toY = (value) => height - margin - ((value - y[0]) / (y[1] - y[0])) * (height - 2 * margin);
  const line = (from, to, style, wide) => {
    context.strokeStyle = style;
    context.lineWidth = wide;
    context.beginPath();
    context.moveTo(from[0], from[1]);
    context.lineTo(to[0], to[1]);
    context.stroke();
  };
  if (zero) line([0, toY(0)], [width, toY(0)], zero, 1);
  if (mark !== undefined) line([toX(mark), 0], [toX(mark), height], color, 1);
  context.strokeStyle = color;
  context.lineWidth = 1.75;
  context.lineJoin = "round";
  context.beginPath();
  points.forEach(([px, py], i) => context[i ? "lineTo" : "moveTo"](toX(px), toY(py)));
  context.stroke();
  if (!labels) return;
  context.fillStyle = labels;
  context.font = "12px system-ui, sans-serif";
  context.textBaseline = "middle";
  let free = height + 7; // for the next label, from below
  const values = points.map(([, value]) => value);
  const ends = [Math.min(...values), 0, Math.max(...values)].sort((a, b) => a - b);
  for (const value of new Set(ends)) {
    free = Math.min(toY(value), free - 13);
    const text = Math.round(value).toLocaleString("en").replace("-", "−");
    context.fillText(text, width + 6, free);
  }
}
