// @ts-check
/** The progress of a study, for its operator. */
import { Seat } from "./server.js";

const EVERY = 3000;  // milliseconds
const BAR = 2;  // rem, height of the largest bar
const seat = new Seat();
let isPaused = false;
/** @param {string} id */
const element = (id) => /** @type {any} */ (document.getElementById(id));

/** @param {any} content */
const cell = (content) => {
  const one = document.createElement("td");
  one.append(content);
  return one;
};

/** @param {number[]} counts */
function bars(counts) {
  const box = document.createElement("div"), most = Math.max(1, ...counts);
  box.className = "bars";
  box.append(...counts.map((count, bin) => {
    const bar = document.createElement("span");
    bar.style.height = `${BAR * count / most}rem`;
    bar.title = `${count} from ${bin / counts.length} on`;
    return bar;
  }));
  return box;
}

/** @param {{title: string, paused: boolean, saves: boolean, participants: number, environments: any[]}} study */
function show({ title, paused, saves, participants, environments }) {
  isPaused = paused;
  element("title").textContent = title || "Study";
  element("people").textContent = `${participants} participant${participants === 1 ? "" : "s"}`;
  element("pause").disabled = false;
  element("pause").textContent = paused ? "Resume" : "Pause";
  const problem = "Episodes cannot be saved: is the disk full? Until they can, no scenes are offered.";
  element("status").textContent = !saves ? problem : paused ? "Paused: no new scenes are offered." : "Running.";
  element("rows").replaceChildren(...environments.map(({ environment, accepted, wanted, leased, histogram, refused }) => {
    const row = document.createElement("tr"), name = document.createElement("th");
    name.textContent = environment;
    const reasons = Object.entries(refused).map(([reason, count]) => `${count}: ${reason}`).join("; ");
    row.append(name, ...[String(accepted), wanted === null ? "all that come" : String(wanted), String(leased)].map(cell), cell(bars(histogram)), cell(reasons));
    return row;
  }));
}

/** @param {object} question */
const ask = (question) => seat.ask(question).then(show, (error) => { element("status").textContent = error.message; });

element("pause").onclick = () => ask({ pause: !isPaused });
await ask({ status: true });
setInterval(() => ask({ status: true }), EVERY);
