/* Time series as SVG. One that the run has no values of is left out. */

import { $, clock, html, number, svg } from "./words.js";

const CHARTS = [
  { title: "In range, of all connected", unit: "%", scale: 100, top: 1, lines: [["in_range_share", "learned", "learned"], ["static_in_range_share", "static", "hovering"]] },
  { title: "Coverage of those served", unit: "%", scale: 100, top: 1, lines: [["coverage", "learned", "learned"], ["static_coverage", "static", "hovering"]] },
  { title: "Connectivity", unit: "%", scale: 100, top: 1, lines: [["connectivity", "learned", "learned"], ["connectivity_neighbor", "neighbor", "neighbour"], ["static_connectivity", "static", "hovering"]] },
  { title: "Traffic carried", unit: "Mbit/s", scale: 1, lines: [["carried_mbps", "learned", "learned"], ["delivered_mbps", "neighbor", "delivered"], ["static_carried_mbps", "static", "hovering"]] },
  { title: "Mean battery in the air", unit: "%", scale: 1, lines: [["energy_percent", "learned", "learned"]] },
];
const LEFT = 36, RIGHT = 8, TOP = 6;
const ROUND = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 21600, 86400];

export class Charts {
  constructor(run, seek) {
    this.run = run;
    const parent = $("charts");
    parent.replaceChildren();
    this.charts = CHARTS.map((chart) => ({ ...chart, lines: chart.lines.filter(([name]) => !run.live || LIVE.has(name)) }))
      .filter(({ lines }) => lines.length);
    for (const chart of this.charts) {
      const box = html("div", { className: "chart" }, parent);
      const head = html("header", {}, box);
      chart.heading = html("h2", {}, head);
      chart.values = html("div", { className: "values" }, head);
      chart.plot = html("div", { className: "plot" }, box);
      chart.svg = svg("svg", { role: "img", "aria-label": chart.title + " over time" }, chart.plot);
      const scrub = (event) => {
        const bounds = chart.svg.getBoundingClientRect();
        const share = (event.clientX - bounds.left - LEFT) / (bounds.width - LEFT - RIGHT);
        seek(Math.round(run.first + share * (run.steps - run.first)));
      };
      chart.svg.addEventListener("pointerdown", (event) => { chart.svg.setPointerCapture(event.pointerId); scrub(event); });
      chart.svg.addEventListener("pointermove", (event) => { if (event.buttons) scrub(event); });
    }
  }

  draw(zone) {
    const { run } = this;
    const width = this.charts[0].plot.clientWidth;
    const plotWidth = Math.max(40, width - LEFT - RIGHT);
    const first = Math.max(0, run.first), span = Math.max(1, run.steps - first);
    const px = (at) => LEFT + ((at - first) / span) * plotWidth;
    this.charts.forEach((chart, index) => {
      const last = index === this.charts.length - 1;
      chart.heading.textContent = chart.title + (zone ? ", zone " + zone : "");
      const plotHeight = Math.max(20, chart.plot.clientHeight - 12);
      const series = chart.lines.map(([name]) => run.metric(name, zone));
      let low = Infinity, high = -Infinity;
      for (const values of series) {
        for (let at = first; at < values.length; at++) {
          if (values[at] < low) low = values[at];
          if (values[at] > high) high = values[at];
        }
      }
      if (low > high) [low, high] = [0, 1];
      if (chart.top) {
        high = chart.top;
        low = Math.max(0, Math.floor(low * 5 - 1e-6) / 5);
      } else {
        const unit = 10 ** Math.floor(Math.log10(Math.max(high - low, high * 0.1, 1e-6)));
        low = Math.max(0, Math.floor(low / unit) * unit);
        high = Math.max(Math.ceil(high / unit) * unit, low + unit);
      }
      const py = (value) => TOP + plotHeight * (1 - (value - low) / (high - low));
      Object.assign(chart, { px, py });
      chart.svg.replaceChildren();
      chart.svg.setAttribute("viewBox", `0 0 ${width} ${chart.plot.clientHeight}`);
      if (span / run.periodSteps <= 60) {
        for (let at = (run.periodOf(first) + 1) * run.periodSteps; at < run.steps; at += run.periodSteps) {
          svg("line", { class: "period", x1: px(at), x2: px(at), y1: TOP, y2: TOP + plotHeight }, chart.svg);
        }
      }
      for (const value of plotHeight < 44 ? [low, high] : [low, (low + high) / 2, high]) {
        svg("line", { class: "axis", x1: LEFT, x2: LEFT + plotWidth, y1: py(value), y2: py(value) }, chart.svg);
        svg("text", { x: LEFT - 6, y: py(value) + 3.5, "text-anchor": "end" }, chart.svg).textContent =
          +(value * chart.scale).toFixed(1);
      }
      if (last) {
        const total = span * run.stepSeconds;
        const gap = ROUND.find((seconds) => total / seconds <= plotWidth / 62) ?? total;
        for (let at = Math.ceil((first * run.stepSeconds) / gap) * gap; at <= run.steps * run.stepSeconds; at += gap) {
          svg("text", { x: px(at / run.stepSeconds), y: TOP + plotHeight + 15, "text-anchor": "middle" }, chart.svg).textContent =
            clock(run, at / run.stepSeconds);
        }
      }
      const every = Math.max(1, Math.floor(span / (2 * plotWidth)));
      chart.lines.forEach(([, kind], line) => {
        let path = "", pen = "M";
        for (let at = first; at < series[line].length; at += every) {
          const value = series[line][at];
          if (Number.isFinite(value)) {
            path += pen + px(at).toFixed(1) + " " + py(value).toFixed(1);
            pen = "L";
          } else pen = "M";
        }
        svg("path", { class: "series " + kind, d: path }, chart.svg);
      });
      for (const { dot } of chart.marks ?? []) dot.remove();
      chart.cursor ??= html("div", { className: "cursor" }, chart.plot);
      chart.cursor.style.height = TOP + plotHeight + "px";
      chart.values.replaceChildren();
      chart.marks = chart.lines.map(([, kind, text], line) => {
        const value = html("span", {}, chart.values);
        if (chart.lines.length > 1) value.append(text + " ");
        return {
          values: series[line], text: html("b", { className: kind }, value),
          dot: html("div", { className: "dot " + kind }, chart.plot),
        };
      });
    });
  }

  /* Cursor and dots lie over the curves as elements of their own, which move without the curves being painted again. */
  cursor(at, time) {
    for (const chart of this.charts) {
      if (!chart.px) continue;
      chart.cursor.style.transform = `translate(${chart.px(time).toFixed(1)}px, 3px)`;
      for (const mark of chart.marks) {
        const value = mark.values[at];
        if (mark.at === at && mark.value === value) continue;
        Object.assign(mark, { at, value });
        mark.text.textContent = number(value * chart.scale, 1) + " " + chart.unit;
        mark.dot.hidden = !Number.isFinite(value);
        if (!mark.dot.hidden) mark.dot.style.transform = `translate(${chart.px(at).toFixed(1)}px, ${chart.py(value).toFixed(1)}px)`;
      }
    }
  }
}

const LIVE = new Set(["in_range_share", "coverage", "connectivity", "energy_percent"]);
