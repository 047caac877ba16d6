/* What charts of uPlot share: they fill their element, and a line may go across. */
import { colour, font } from "./css-colour.js";

/** Draw a chart that stays as large as its element; answers {chart, close}. */
export function drawFilling(element, data, options) {
  const size = () => ({ width: element.clientWidth, height: element.clientHeight });
  const chart = new uPlot({ ...size(), legend: { show: false }, cursor: { show: false }, ...options }, data, element);
  const watcher = new ResizeObserver(() => {
    if (element.clientWidth) chart.setSize(size());
  });
  watcher.observe(element);
  return {
    chart,
    close() {
      watcher.disconnect();
      chart.destroy();
    },
  };
}

/** What both axes have in common. */
export const axisStyle = () => ({ stroke: colour("quiet"), font: font(12), ticks: { show: false } });

/** Draw a line at a value of the scale y, dashed for a target or a limit; nothing where the value is null. */
export function drawLevel(chart, value, { tone = "text", width = 1.5 * devicePixelRatio, dash = [7, 5] } = {}) {
  if (value === null) return;
  const y = Math.round(chart.valToPos(value, "y", true)) + 0.5;
  const { left, width: length } = chart.bbox;
  chart.ctx.save();
  chart.ctx.strokeStyle = colour(tone);
  chart.ctx.lineWidth = width;
  chart.ctx.setLineDash(dash.map((px) => px * devicePixelRatio));
  chart.ctx.beginPath();
  chart.ctx.moveTo(left, y);
  chart.ctx.lineTo(left + length, y);
  chart.ctx.stroke();
  chart.ctx.restore();
}
