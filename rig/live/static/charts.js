// The four charts. They keep a thinned past of their own, so that hours cost no more than minutes.
import { echarts } from "nicegui-echart";

const KEPT = 4000;
const TRAIL = 800;
const REDRAW_MS = 100;
const WINDOW_S = 60;
const Z_95 = 1.96;
const T = 0, MEASURED = 1, STD = 4, MODEL = 7, ERROR = 10, MEAN = 11;

const RATIOS = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];

// The smallest step of 1, 2 or 5 times a power of ten that is at least `least`.
function niceStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].find((k) => k * power >= least * (1 - 1e-9)) * power;
}

function extent(values) {
  let low = Infinity, high = -Infinity;
  for (const value of values) {
    if (value === null) continue;
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return low <= high ? [low, high] : [0, 0];
}

// An axis around values from and to a multiple of its step: at most `steps` of them and at least two, so that it has three labels.
function axisAround([low, high], least, steps) {
  if (high - low < least) [low, high] = [(low + high - least) / 2, (low + high + least) / 2];
  for (let step = niceStep((high - low) / steps); ; step = niceStep(1.5 * step)) {
    const min = step * Math.floor(low / step + 1e-9), max = step * Math.ceil(high / step - 1e-9);
    if (max - min <= (steps + 0.5) * step) return { min, max: Math.max(max, min + 2 * step), interval: step };
  }
}

const fromZero = (values, least) => axisAround([0, Math.max(least, extent(values)[1])], least, 4);

const GRID = { left: 46, right: 14, top: 26, bottom: 26 };

const css = (name) => getComputedStyle(document.body).getPropertyValue(name).trim();
const find = (name) => {
  const element = document.querySelector(`.chart-${name}`);
  return element && echarts.getInstanceByDom(element);
};

export class Charts {
  static find() {
    const charts = ["pressure", "plane", "tip", "error"].map(find);
    return charts.every(Boolean) ? new Charts(...charts) : null;
  }

  constructor(pressure, plane, tip, error) {
    Object.assign(this, { pressure, plane, tip, error, drawn: 0, t: 0 });
  }

  begin(about) {
    this.about = about;
    this.pressures = [];
    this.track = [];
    this.spread = [0, 0, 0, 0, 0, 0];
    this.colours();
  }

  add(pressures, track, t) {
    this.t = t;
    this.pressures = thinned(this.pressures.concat(pressures));
    for (const row of track) this.spreadBy(row);
    this.track = thinned(this.track.concat(track));
    if (performance.now() - this.drawn < REDRAW_MS) return;
    this.drawn = performance.now();
    this.draw();
  }

  // The plane of motion is the upright one in which the tip moves most.
  spreadBy(row) {
    const x = row[MEASURED], y = row[MEASURED + 1];
    if (x === null) return;
    const s = this.spread;
    s[0] += 1; s[1] += x; s[2] += y; s[3] += x * x; s[4] += x * y; s[5] += y * y;
  }

  direction() {
    const [n, x, y, xx, xy, yy] = this.spread;
    if (n < 2) return [1, 0];
    const a = xx / n - (x / n) ** 2, b = xy / n - (x * y) / n / n, c = yy / n - (y / n) ** 2;
    if (a + c < 1) return [1, 0]; // less than a millimetre: it has not moved
    const angle = 0.5 * Math.atan2(2 * b, a - c);
    const sign = Math.abs(Math.cos(angle)) > 0.5 ? Math.sign(Math.cos(angle)) : Math.sign(Math.sin(angle));
    return [sign * Math.cos(angle), sign * Math.sin(angle)];
  }

  colours() {
    if (!this.about) return;
    const ink = css("--ink"), muted = css("--muted"), rule = css("--rule");
    // ECharts takes a line's height from a Chinese letter, which many machines draw as a small mark.
    const small = { color: muted, fontSize: 13, lineHeight: 14 };
    const number = (v) => String(Number(v.toPrecision(6)));
    const axis = ({ axisLabel, ...more } = {}) => ({
      type: "value", axisLabel: { ...small, formatter: number, showMinLabel: true, showMaxLabel: true, ...axisLabel }, nameTextStyle: small,
      axisLine: { lineStyle: { color: muted } }, splitLine: { lineStyle: { color: rule } }, ...more,
    });
    const ticks = { showMinLabel: false, showMaxLabel: false, hideOverlap: true, formatter: (v) => `${number(v)} s` };
    const time = ({ axisLabel, ...more } = {}) => axis({ axisLabel: { ...ticks, ...axisLabel }, ...more });
    const common = { animation: false, textStyle: { color: ink }, grid: GRID };
    const legend = (data) => ({ data, top: 0, right: 8, itemHeight: 8, textStyle: { color: ink, fontSize: 13 } });
    const line = (name, colour, more) => ({
      name, type: "line", showSymbol: false, silent: true, color: colour, lineStyle: { width: 2, color: colour }, data: [], ...more,
    });
    const n = this.about.actuators;
    const names = [...Array(n).keys()].map((i) => String(i + 1));
    this.pressure.setOption({
      ...common, legend: legend(names), xAxis: time(), yAxis: axis(),
      series: [
        ...names.map((name, i) => line(`${name} set`, css(`--a${(i % 6) + 1}`), { lineStyle: { width: 1.5, type: "dashed", color: css(`--a${(i % 6) + 1}`) } })),
        ...names.map((name, i) => line(name, css(`--a${(i % 6) + 1}`))),
      ],
    }, true);
    const dot = (colour, symbol) => ({ type: "scatter", symbol, symbolSize: 13, silent: true, itemStyle: { color: "transparent", borderColor: colour, borderWidth: 3 }, data: [] });
    const measured = css("--measured"), model = css("--model"), dashed = { width: 2, type: "dashed", color: model };
    this.plane.setOption({
      ...common, legend: legend(["measured", "model"]), xAxis: axis(), yAxis: axis({ inverse: true, axisLabel: { showMaxLabel: false } }),
      title: { left: 40, top: 0, textStyle: { ...small, fontWeight: 400 } },
      series: [line("measured", measured), line("model", model, { lineStyle: dashed }), dot(measured, "circle"), dot(model, "rect")],
    }, true);
    const band = (name, i) => [
      line(`${name} low`, measured, { xAxisIndex: i, yAxisIndex: i, stack: `band ${i}`, stackStrategy: "all", lineStyle: { opacity: 0 } }),
      line(`${name} band`, measured, { xAxisIndex: i, yAxisIndex: i, stack: `band ${i}`, stackStrategy: "all", lineStyle: { opacity: 0 }, areaStyle: { color: measured, opacity: 0.3 } }),
      line("measured", measured, { xAxisIndex: i, yAxisIndex: i }),
      line("model", model, { xAxisIndex: i, yAxisIndex: i, lineStyle: dashed }),
    ];
    this.tip.setOption({
      animation: false, textStyle: { color: ink }, legend: legend(["measured", "model"]),
      grid: [{ left: 54, right: 14, top: 26, bottom: "53%" }, { left: 54, right: 14, top: "57%", bottom: 26 }],
      xAxis: [time({ gridIndex: 0, axisLabel: { show: false } }), time({ gridIndex: 1 })],
      yAxis: [axis({ gridIndex: 0, name: "r", nameLocation: "middle", nameGap: 36 }), axis({ gridIndex: 1, name: "z", nameLocation: "middle", nameGap: 36, inverse: true })],
      series: [...band("r", 0), ...band("z", 1)],
    }, true);
    this.error.setOption({
      ...common, legend: legend(["error", "mean"]), xAxis: time(), yAxis: axis(),
      series: [line("error", css("--measured")), line("mean", ink, { lineStyle: { width: 2.5, type: "dashed", color: ink } })],
    }, true);
    this.draw();
  }

  // z is drawn to the scale of r, or one of the two larger by a round factor, which the chart states.
  planeAxes(points) {
    const width = this.plane.getWidth() - GRID.left - GRID.right, height = this.plane.getHeight() - GRID.top - GRID.bottom;
    const r = axisAround(extent(points.map(([along]) => along)), 4, 6), [low, high] = extent(points.map(([, down]) => down));
    const equal = (height / width) * (r.max - r.min); // what z spans at the scale of r
    for (const ratio of RATIOS.toReversed()) {
      const span = equal / ratio, step = niceStep(span / 5), min = step * Math.ceil((high - span) / step);
      if (min > low || span < 1) continue;
      const text = ratio === 1 ? "equal scale" : ratio > 1 ? `z enlarged ${ratio} x` : `r enlarged ${Math.round(1 / ratio)} x`;
      return { title: { text }, xAxis: r, yAxis: { min, max: min + span, interval: step } };
    }
    return { xAxis: r };
  }

  draw() {
    const n = this.about.actuators, from = this.t - WINDOW_S;
    const recent = this.pressures.filter((row) => row[T] >= from && row[T] <= this.t + 1);
    const span = { min: Math.max(0, from), max: Math.max(this.t, 1) };
    span.interval = niceStep((span.max - span.min) / 10); // at most a quarter of it: three labels inside
    const pressures = recent.flatMap((row) => row.slice(1));
    this.pressure.setOption({ xAxis: span, yAxis: fromZero(pressures, 0.1), series: [...Array(2 * n).keys()].map((i) => ({ data: recent.map((row) => [row[T], row[1 + i]]) })) });
    const [cx, cy] = this.direction();
    const along = (row, k) => (row[k] === null ? null : row[k] * cx + row[k + 1] * cy);
    const every = Math.ceil(this.track.length / TRAIL);
    const trail = (k) => this.track.filter((_, i) => i % every === 0).map((row) => [along(row, k), row[k + 2]]);
    const last = this.track.at(-1);
    const here = (k) => (last && last[k] !== null ? [[along(last, k), last[k + 2]]] : []);
    this.plane.setOption({ ...this.planeAxes(trail(MEASURED).concat(trail(MODEL))), series: [{ data: trail(MEASURED) }, { data: trail(MODEL) }, { data: here(MEASURED) }, { data: here(MODEL) }] });
    const track = this.track.filter((row) => row[T] >= from);
    const heights = (value, model) => axisAround(extent(track.flatMap((row) => [value(row), model(row)])), 1, 3);
    const bands = (value, spread, model) => [
      { data: track.map((row) => [row[T], value(row) === null ? null : value(row) - Z_95 * spread(row)]) },
      { data: track.map((row) => [row[T], value(row) === null ? null : 2 * Z_95 * spread(row)]) },
      { data: track.map((row) => [row[T], value(row)]) },
      { data: track.map((row) => [row[T], model(row)]) },
    ];
    this.tip.setOption({
      xAxis: [span, span],
      yAxis: [
        heights((row) => along(row, MEASURED), (row) => along(row, MODEL)),
        heights((row) => row[MEASURED + 2], (row) => row[MODEL + 2]),
      ],
      series: [
        ...bands((row) => along(row, MEASURED), (row) => Math.hypot(row[STD] * cx, row[STD + 1] * cy), (row) => along(row, MODEL)),
        ...bands((row) => row[MEASURED + 2], (row) => row[STD + 2], (row) => row[MODEL + 2]),
      ],
    });
    const errors = track.flatMap((row) => [row[ERROR], row[MEAN]]);
    this.error.setOption({ xAxis: span, yAxis: fromZero(errors, 0.1), series: [{ data: track.map((row) => [row[T], row[ERROR]]) }, { data: track.map((row) => [row[T], row[MEAN]]) }] });
  }
}

function thinned(rows) {
  return rows.length > KEPT ? rows.filter((_, i) => i % 2 === 0 || i === rows.length - 1) : rows;
}
