// @ts-check
/** Plots of the sensors, or of the joints' positions for models without sensors, over the last seconds. */
import uPlot from "./three/uPlot.esm.js";

const KEPT = 1500;  // values per line
const COLOURS = ["#2f6f92", "#c0632b", "#3d8a4e", "#8a4fa0", "#b03a53", "#7a7a24", "#277f86", "#666b7a"];

export class Plots {
  /** @param {HTMLElement} container @param {HTMLSelectElement} choice */
  constructor(container, choice) {
    this.container = container;
    this.choice = choice;
    choice.addEventListener("change", () => this.#choose());
    new ResizeObserver(() => this.plot?.setSize(this.#size())).observe(container);
  }

  /** Starts the plots of another model. @param {import("./inspected.js").InspectedModel} inspected */
  open(inspected) {
    const { model } = inspected;
    const sensors = inspected.names("sensor", "sensor", model.nsensor).map((name, id) => ({ name, at: model.sensor_adr[id], from: "sensordata" }));
    const joints = inspected.names("jnt", "joint", model.njnt).map((name, id) => ({ name, at: model.jnt_qposadr[id], from: "qpos" }));
    this.inspected = inspected;
    this.lines = sensors.length ? sensors : joints;
    const groups = Map.groupBy(this.lines, ({ name }) => name.split("_")[0]);
    this.choice.replaceChildren(...[...groups].filter(([, lines]) => lines.length > 1).map(([name]) => new Option(`${name}: all`, `${name}_`)),
      ...this.lines.map(({ name }) => new Option(name)));
    if (groups.has("robot")) this.choice.value = "robot_";
    this.#choose();
  }

  #size() {
    return { width: Math.max(200, this.container.clientWidth), height: 190 };
  }

  #choose() {
    const { value } = this.choice;
    this.shown = (this.lines ?? []).filter(({ name }) => name === value || (value.endsWith("_") && name.startsWith(value))).slice(0, COLOURS.length);
    this.plot?.destroy();
    this.values = [[], ...this.shown.map(() => [])];
    const ink = getComputedStyle(this.container).color, axis = { stroke: ink, grid: { stroke: "#8884" }, ticks: { stroke: "#8888" } };
    this.plot = new uPlot({
      ...this.#size(),
      scales: { x: { time: false } },
      axes: [{ ...axis }, { ...axis, size: 55 }],
      series: [{ label: "s" }, ...this.shown.map(({ name }, i) => ({ label: name, stroke: COLOURS[i], width: 1.5 }))],
    }, this.values, this.container);
  }

  /** Adds the current values. */
  note() {
    const { data } = /** @type {any} */ (this.inspected), [times, ...rows] = /** @type {number[][]} */ (this.values);
    if (times.length && data.time < times[times.length - 1]) for (const row of [times, ...rows]) row.length = 0;
    if (times[times.length - 1] === data.time) return;
    times.push(data.time);
    const sources = { sensordata: data.sensordata, qpos: data.qpos };
    rows.forEach((row, i) => row.push(sources[/** @type {keyof typeof sources} */ (this.shown?.[i].from)][/** @type {any} */ (this.shown)[i].at]));
    if (times.length > KEPT) for (const row of [times, ...rows]) row.shift();
  }

  draw() {
    if (this.container.offsetParent) this.plot?.setData(this.values);
  }
}
