/** Charts over time, drawn by uPlot, in the colours of the present scheme. */

import { $, colours, fixed, isKnown, make } from "./format.js";

export const SPAN = 120; // s that a live chart shows
const HEIGHT = 170;
const all = [];

/** What is drawn over time: title, unit, names of the lines, and a line that means a bound. */
export class Chart {
  /**
   * @param {{title: string, unit: string, lines: {name: string, colour: string, dash?: number[]}[],
   *   digits?: number, bound?: number, isClock?: boolean}} options
   */
  constructor(options) {
    this.options = options;
    this.data = [[], ...options.lines.map(() => [])];
    this.card = make("section", "", "card chart", [
      make("h2", options.title, "", options.unit ? [make("span", options.unit, "note")] : []),
    ]);
    this.place = make("div");
    this.card.append(this.place);
    $("charts").append(this.card);
    all.push(this);
    new ResizeObserver(() => this.fit()).observe(this.card);
    this.build();
  }

  build() {
    this.plot?.destroy();
    if (!window.uPlot) return;
    const colour = colours();
    const { lines, digits = 2, bound, isClock } = this.options;
    const axis = { stroke: colour.dim, font: "11px system-ui, sans-serif", ticks: { stroke: colour.line, size: 4 },
      grid: { stroke: colour.line, width: 1 } };
    this.plot = new window.uPlot(
      {
        width: this.width(),
        height: HEIGHT,
        cursor: { sync: { key: "time" }, drag: { x: !isClock, y: false }, points: { size: 6 } },
        legend: { live: true },
        scales: { x: { time: Boolean(isClock), range: isClock ? lastSeconds : undefined }, y: { range: (_, low, high) => widen(low, high, bound, digits) } },
        axes: [
          { ...axis, size: 26, space: 70, ...(isClock && { values: clockTimes }) },
          { ...axis, size: 52 },
        ],
        series: [
          isClock ? { value: "{HH}:{mm}:{ss}" } : { label: "s", value: (_, v) => fixed(v, 1) },
          ...lines.map((line) => ({
            label: line.name,
            stroke: colour[line.colour],
            width: 1.5,
            dash: line.dash,
            points: { show: false },
            value: (_, v) => fixed(v, digits),
          })),
        ],
        hooks: { draw: [(plot) => this.mark(plot, colour)] },
      },
      this.data,
      this.place,
    );
  }

  width() {
    return Math.max(this.place.clientWidth || 320, 120);
  }

  fit() {
    const width = this.width();
    if (this.plot && this.plot.width !== width) this.plot.setSize({ width, height: HEIGHT });
  }

  /** Draw the bound, and the moment that the slider of a log shows. */
  mark(plot, colour) {
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.lineWidth = window.devicePixelRatio || 1;
    if (!this.data.slice(1).some((values) => values.some(isKnown))) {
      ctx.fillStyle = colour.dim;
      ctx.font = `${13 * ctx.lineWidth}px system-ui, sans-serif`;
      ctx.textAlign = "center";
      ctx.fillText("no values", bbox.left + bbox.width / 2, bbox.top + bbox.height / 2);
    }
    if (this.options.bound !== undefined) {
      const y = Math.round(plot.valToPos(this.options.bound, "y", true));
      ctx.strokeStyle = colour.bad;
      ctx.setLineDash([6, 5]);
      stroke(ctx, bbox.left, y, bbox.left + bbox.width, y);
    }
    if (this.moment !== undefined) {
      const x = Math.round(plot.valToPos(this.moment, "x", true));
      ctx.strokeStyle = colour.ink;
      ctx.setLineDash([]);
      if (x >= bbox.left && x <= bbox.left + bbox.width) stroke(ctx, x, bbox.top, x, bbox.top + bbox.height);
    }
    ctx.restore();
  }

  /** Show other data: times, then the values of each line; null where not known. */
  set(data) {
    this.data = data;
    this.card.dataset.seconds = data[0].length ? Math.round(data[0].at(-1) - data[0][0]) : 0;
    this.plot?.setData(data);
    this.showLegend();
  }

  /** Move the line of the log's slider there. */
  setMoment(moment) {
    this.moment = moment;
    this.plot?.redraw(false);
    this.showLegend();
  }

  /** Let the legend show the newest values, or those of the slider, unless the mouse is there. */
  showLegend() {
    const times = this.data[0];
    if (!this.plot || this.plot.cursor.left >= 0 || !times.length) return;
    const idx = this.moment === undefined ? times.length - 1 : this.plot.valToIdx(this.moment);
    this.plot.setLegend({ idx }, false);
  }
}

function stroke(context, x1, y1, x2, y2) {
  context.beginPath();
  context.moveTo(x1, y1);
  context.lineTo(x2, y2);
  context.stroke();
}

/** Times of day, all of them with hour and minute. */
const clockTimes = (_, moments) => moments.map((one) => new Date(one * 1000).toLocaleTimeString([], { hour12: false }));

/** The last two minutes, also where there is one moment only. */
const lastSeconds = (_, low, high) => {
  const now = high ?? Date.now() / 1000;
  return [now - SPAN, now];
};

/** A range that does not magnify noise, and shows the bound. */
function widen(low, high, bound, digits) {
  if (low === null || high === null) return [0, bound === undefined ? 1 : 1.2 * bound];
  if (bound !== undefined) return [0, Math.max(1.2 * bound, 1.05 * high)];
  const least = 4 * 10 ** -digits;
  const spare = Math.max(0.08 * (high - low), (least - (high - low)) / 2, 10 ** -digits);
  return [low - spare, high + spare];
}

matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => all.forEach((chart) => chart.build()));
