// Small line charts.

/**
 * @param {HTMLCanvasElement} canvas
 * @param {number[][]} points x, y, each in its range
 * @param {{x: number[], y: number[], color: string, zero?: string, mark?: number}} options
 *   zero: color of a line at 0; mark: x of a vertical line
 */
export function drawLine(canvas, points, { x, y, color, zero, mark }) {
  const ratio = Math.min(devicePixelRatio || 1, 2.5);
  const { clientWidth: width, clientHeight: height } = canvas;
  Object.assign(canvas, { width: width * ratio, height: height * ratio });
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  const toX = (value) => ((value - x[0]) / (x[1] - x[0])) * width;
  const toY = (value) => height - 3 - ((value - y[0]) / (y[1] - y[0])) * (height - 6);
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
}
