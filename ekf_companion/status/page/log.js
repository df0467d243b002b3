/** The page of a log: all of it in the charts, one moment of it in the rest. */

import { Chart } from "./charts.js";
import { $, fixed, isKnown, make, put } from "./format.js";
import { Map } from "./track.js";
import { showEvents, showFacts, showSample, showTable, showVerdict } from "./view.js";

const dashed = { colour: "autopilot", dash: [6, 4] };
const AXES = ["x", "y", "z"];
const axes = AXES.map((name, i) => ({ name, colour: `c${i + 1}` }));

export async function startLog() {
  put("link", "reading");
  const answer = await fetch("log.json");
  if (!answer.ok) return put("link", `no data: ${answer.status}`);
  const log = await answer.json();
  put("link", "log");
  $("link").className = "badge good";
  document.title = `${log.name}: ekf-companion`;
  put("title", log.name);
  put("vehicle", `${log.family} autopilot, ${fixed(log.t[log.t.length - 1], 0)} s`);
  showVerdict(log.kind, log.verdict);
  showEvents(log.events.map(({ t, level, text }) => ({ time: fixed(t, 1, " s"), level, text })));
  showCounts(log);
  showSummary(log.summary);
  return new Player(log);
}

/** Shows one moment at a time. */
class Player {
  constructor(log) {
    this.log = log;
    this.other = log.others[0];
    this.map = new Map();
    this.charts = this.drawCharts();
    this.chooseOther();
    const slider = $("time");
    $("player").hidden = false;
    slider.max = log.t.length - 1;
    slider.addEventListener("input", () => this.show(Number(slider.value)));
    $("play").addEventListener("click", () => this.play(!this.timer));
    document.addEventListener("keydown", (event) => {
      if (event.key === " " && event.target.tagName !== "BUTTON") {
        event.preventDefault();
        this.play(!this.timer);
      }
    });
    for (const chart of this.charts) {
      chart.place.addEventListener("click", () => this.seek(chart.plot));
    }
    this.show(0);
    new ResizeObserver(() => this.show(this.at)).observe($("map"));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.show(this.at));
  }

  /** Let the user choose what our estimate is compared with, where there are several. */
  chooseOther() {
    document.querySelectorAll("th.autopilot").forEach((head) => (head.textContent = short(this.other?.name ?? "autopilot")));
    this.fillTracks();
    if (this.log.others.length < 2 || this.select) return;
    this.select = make("select", "", "", this.log.others.map(({ name }) => make("option", short(name))));
    this.select.setAttribute("aria-label", "compared with");
    this.select.addEventListener("change", () => {
      this.other = this.log.others[this.select.selectedIndex];
      this.chooseOther();
      this.fillCharts();
      this.show(this.at);
    });
    $("player").append(this.select);
  }

  fillTracks() {
    const jumps = new Set(this.log.jumps);
    for (const [name, columns] of [["ours", this.log.ours], ["autopilot", this.other?.columns]]) {
      this.map.tracks[name].points = [];
      columns?.lat_deg?.forEach((lat, i) => {
        if (name === "ours" && jumps.has(i)) this.map.lift(name);
        this.map.tracks[name].add(this.map.place(lat, columns.lon_deg[i]));
      });
    }
  }

  drawCharts() {
    const { log } = this;
    const both = [{ name: "ours", colour: "ours" }, { name: "other", ...dashed }];
    this.height = new Chart({ title: "Height", unit: "m", digits: 1, lines: both });
    this.speed = new Chart({ title: "Speed over ground", unit: "m/s", lines: both });
    this.fillCharts();
    const charts = [this.height, this.speed];
    const add = (options, data) => {
      const chart = new Chart(options);
      chart.set(data);
      charts.push(chart);
    };
    for (const name of log.innovations ? ["position north", "position east", "position down", "velocity north", "velocity east", "velocity down"] : []) {
      const bounds = log.innovations.bounds[name];
      const values = log.innovations.values[name];
      if (!values.some(isKnown)) continue;
      const bound = { colour: "dim", dash: [5, 5] };
      add({ title: `Innovation, ${name}`, unit: name.startsWith("p") ? "m, three sigmas" : "m/s, three sigmas", lines: [{ name: "fix", colour: "c1" }, { name: "+", ...bound }, { name: "\u2212", ...bound }] },
        [log.innovations.t, values, bounds, bounds.map((one) => (isKnown(one) ? -one : null))]);
    }
    const used = Object.keys(log.looks.nis).filter((aid) => log.looks.nis[aid].some(isKnown));
    const aids = used.map((name, i) => ({ name, colour: `c${i + 1}` }));
    add({ title: "NIS in each second", unit: "1: as it should be", bound: 1, lines: aids }, [log.looks.t, ...used.map((aid) => log.looks.nis[aid])]);
    const refused = Object.keys(log.looks.refused);
    const reasons = refused.map((name, i) => ({ name, colour: `c${(i % 6) + 1}` }));
    if (refused.length) add({ title: "Refused", unit: "1/s", digits: 0, lines: reasons }, [log.looks.t, ...refused.map((name) => log.looks.refused[name])]);
    add({ title: "Gyro bias", unit: "deg/s", digits: 3, lines: axes }, [log.t, ...AXES.map((one) => log.estimate[`gyro_bias_${one}`])]);
    add({ title: "Accelerometer bias", unit: "m/s\u00b2", digits: 3, lines: axes }, [log.t, ...AXES.map((one) => log.estimate[`accel_bias_${one}`])]);
    return charts;
  }

  fillCharts() {
    const nothing = this.log.t.map(() => null);
    const speed = (columns) => columns?.v_north?.map((north, i) => (isKnown(north) ? Math.hypot(north, columns.v_east[i]) : null)) ?? nothing;
    this.height.set([this.log.t, this.log.ours.alt_m ?? nothing, this.other?.columns.alt_m ?? nothing]);
    this.speed.set([this.log.t, speed(this.log.ours), speed(this.other?.columns)]);
  }

  seek(plot) {
    if (!plot || plot.cursor.left < 0) return;
    const moment = plot.posToVal(plot.cursor.left, "x");
    const at = this.log.t.findIndex((t) => t >= moment);
    this.show(at < 0 ? this.log.t.length - 1 : at);
  }

  play(isOn) {
    clearInterval(this.timer);
    this.timer = null;
    put("play", isOn ? "\u23f8" : "\u25b6");
    if (!isOn) return;
    const [start, begin] = [performance.now(), this.at >= this.log.t.length - 1 ? 0 : this.log.t[this.at]];
    this.timer = setInterval(() => {
      const moment = begin + (performance.now() - start) / 1000;
      const at = this.log.t.findIndex((t) => t >= moment);
      if (at < 0) this.play(false);
      else this.show(at);
    }, 100);
  }

  show(at) {
    this.at = at;
    const { log } = this;
    $("time").value = at;
    put("clock", fixed(log.t[at], 1, " s"));
    const sample = { ...moment(log.ours, at), ...sigmas(log.estimate, at) };
    showSample(sample, this.other ? moment(this.other.columns, at) : null, this.map, "log");
    this.charts.forEach((chart) => chart.setMoment(log.t[at]));
    const { estimate } = log;
    showFacts([
      ["estimate", estimate.status[at].replace("_", " "), estimate.status[at] === "ok" ? "good" : "bad"],
      ["velocity", `${["north", "east", "down"].map((axis) => `${fixed(log.ours[`v_${axis}`]?.[at], 2)} ${axis}`).join(", ")}, m/s`],
      ["compared with", this.other?.name ?? "nothing"],
      ["gyro bias", `${AXES.map((one) => fixed(estimate[`gyro_bias_${one}`][at], 3)).join(", ")} deg/s`],
      ["accel. bias", `${AXES.map((one) => fixed(estimate[`accel_bias_${one}`][at], 3)).join(", ")} m/s\u00b2`],
    ]);
  }
}

const short = (name) => name.split(" (")[0];

/** One moment of columns, as a live estimate is. */
function moment(columns, at) {
  const one = Object.fromEntries(Object.entries(columns).map(([name, values]) => [name, values[at]]));
  return { ...one, vel_ned_m_s: [one.v_north, one.v_east, one.v_down] };
}

function sigmas(estimate, at) {
  const of = (name) => estimate[`sd_${name}`][at];
  return {
    sigma: { north_m: of("pos_n"), east_m: of("pos_e"), alt_m: of("pos_d"), vel_ned_m_s: [of("vel_n"), of("vel_e"), of("vel_d")],
      roll_deg: of("roll"), pitch_deg: of("pitch"), heading_deg: of("yaw") },
    ellipse_m2: [of("pos_n") ** 2, 0, of("pos_e") ** 2],
  };
}

function showCounts({ looks }) {
  const sum = (values) => values.reduce((a, b) => a + b, 0);
  const refused = (aid) => Object.keys(looks.refused).filter((name) => name.startsWith(`${aid} `))
    .map((name) => `${sum(looks.refused[name])}${name.slice(aid.length)}`).join(", ");
  const rows = Object.keys(looks.fused).map((aid) => [aid, sum(looks.fused[aid]), refused(aid)]);
  showTable("stages", ["aid", "fused", "refused"], rows.filter(([, fused, words]) => fused || words)
    .map(([aid, fused, words]) => [aid, String(fused), [words || "0", words ? "bad" : ""]]));
}

/** What was found, in place of the rates of a link. */
function showSummary(lines) {
  const card = $("rates").closest("section");
  card.querySelector("h2").textContent = "Summary";
  $("stages").closest("section").querySelector("h2").textContent = "Fused and refused";
  card.querySelector("div").replaceChildren(make("pre", lines.join("\n")));
}
