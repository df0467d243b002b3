/** The page of a running daemon. */

import { Chart, SPAN } from "./charts.js";
import { $, fixed, isKnown, put } from "./format.js";
import { Link } from "./link.js";
import { Map } from "./track.js";
import { showEvents, showFacts, showSample, showTable, showVerdict, speedOf } from "./view.js";

const OLD = 1; // s without an inertial sample: OLD_S of status/judge.py
const RECENT = 3; // s since an aid was refused, or used: LAPSE_NS of status/aids.py
const AIDS = document.documentElement.dataset.aids.split(" ");
const dashed = { colour: "autopilot", dash: [6, 4] };
const axes = ["x", "y", "z"].map((name, i) => ({ name, colour: `c${i + 1}` }));
const aids = AIDS.map((name, i) => ({ name, colour: `c${i + 1}` }));
const VERDICTS = ["fused", "deweighted", "gated", "denied", "suspect", "disturbed", "superseded", "before_alignment"];

export function startLive() {
  const map = new Map();
  const clock = (options) => ({ chart: new Chart({ ...options, isClock: true }), rows: options.rows });
  const charts = [
    clock({ title: "Height", unit: "m", digits: 1, lines: [{ name: "ours", colour: "ours" }, { name: "autopilot", ...dashed }],
      rows: (live) => [live.alt_m, live.autopilot?.alt_m] }),
    clock({ title: "Speed over ground", unit: "m/s", lines: [{ name: "ours", colour: "ours" }, { name: "autopilot", ...dashed }],
      rows: (live) => [speedOf(live), speedOf(live.autopilot)] }),
    clock({ title: "Innovations over their gates", unit: "above 1: refused", bound: 1, lines: aids,
      rows: (live) => AIDS.map((aid) => live.ratios[aid]) }),
    clock({ title: "NIS over 20 s", unit: "1: as it should be", bound: 1, lines: aids,
      rows: (live) => AIDS.map((aid) => live.nis[aid]) }),
    clock({ title: "Gyro bias", unit: "deg/s", digits: 3, lines: axes, rows: (live) => live.gyro_bias_deg_s }),
    clock({ title: "Accelerometer bias", unit: "m/s\u00b2", digits: 3, lines: axes, rows: (live) => live.accel_bias_m_s2 }),
  ];
  charts.forEach((one) => (one.data = [[], ...one.chart.options.lines.map(() => [])]));
  let count = 0;
  let seen; // the newest status
  let resets; // of the newest estimate
  let age; // s of the newest sample; null: there is no estimate, undefined: not known

  const onLive = (live) => {
    const wasOld = document.body.classList.contains("old");
    const isOld = showAge(live);
    // Over a reset it has not flown
    if (live && live.resets !== resets) map.lift("ours");
    resets = live?.resets;
    showSample(live, live?.autopilot, map, isOld ? "old" : "live");
    // The state comes once a second: what is red at the top must not be green below it until then
    if (seen && live && isOld !== wasOld) showState({ ...seen, sample_age_s: live.age_s });
    age = live === null ? null : live.age_s;
    showLink(link, age);
    if (!live) return;
    const now = Date.now() / 1000;
    // Without samples the estimate stands still: a gap, no line
    for (const one of charts) append(one.data, now, isOld ? [] : one.rows(live));
    // Half of the messages: an eye sees no more in a chart
    if (count++ % 2 === 0) charts.forEach((one) => one.chart.set(one.data));
  };
  const onStatus = (status) => {
    seen = status;
    showState(status);
  };
  fetch("past").then((answer) => (answer.ok ? answer.json() : [])).then(fill).catch(() => {});
  /** Put what was before the page opened in front of what has come since. */
  function fill(past) {
    const now = Date.now() / 1000;
    const first = charts[0].data[0][0] ?? now;
    const rows = past.map(([old, live]) => [now - old, live]).filter(([at, live]) => at < first && live);
    map.addPast(rows.map(([, live]) => live));
    for (const one of charts) {
      const before = [[], ...one.chart.options.lines.map(() => [])];
      for (const [at, live] of rows) append(before, at, live.age_s < OLD ? one.rows(live) : []);
      one.data = one.data.map((column, i) => before[i].concat(column));
      one.chart.set(one.data);
    }
  }

  let link = ["wait", "connecting"];
  let state = "";
  new Link(
    (message) => {
      if ("live" in message) onLive(message.live);
      if ("status" in message) onStatus(message.status);
      if ("events" in message) showEvents(message.events.map(timed));
    },
    (kind, words) => {
      link = [kind, words];
      showLink(link, age);
      document.body.classList.toggle("stale", kind === "bad");
      // A pause shows as a gap of the lines
      if (state === "good" && kind !== "good") {
        charts.forEach((one) => append(one.data, Date.now() / 1000, []));
        map.lift("ours", "autopilot");
      }
      // The state of the last message may no longer be true
      if (kind === "bad" && state !== kind) {
        showVerdict("wait", "not known: nothing comes from the daemon");
        if (seen) put("vehicle", vehicleOf(seen, false));
      }
      state = kind;
    },
  );
}

/** Show whether the page is up to date: the connection, and the age of its data. */
function showLink([kind, words], age) {
  let shown = [kind, words];
  if (kind === "good" && age === null) shown = ["wait", "no estimate yet"];
  else if (kind === "good" && age !== undefined && !(age < OLD)) shown = ["bad", `no samples for ${fixed(age, 0, " s")}`];
  put("link", shown[1]);
  $("link").className = `badge ${shown[0]}`;
}

/** Show the estimate's age if no samples come; return whether it is old. */
function showAge(live) {
  const isOld = live !== null && !(live.age_s < OLD);
  document.body.classList.toggle("old", isOld);
  const words = isOld ? `${fixed(live.age_s, 0, " s")} old` : "";
  document.querySelectorAll(".old-note").forEach((note) => put(note, words, "note old-note"));
  return isOld;
}

/** Add one row to columns, and drop rows that are older than a chart shows. */
function append(data, now, row) {
  data[0].push(now);
  for (let i = 1; i < data.length; i++) data[i].push(isKnown(row[i - 1]) ? row[i - 1] : null);
  let old = 0;
  while (data[0][old] < now - SPAN) old++;
  if (old > 20) data.forEach((column) => column.splice(0, old));
}

const timed = ({ unix_s, level, text }) => ({ time: new Date(unix_s * 1000).toLocaleTimeString([], { hour12: false }), level, text });

/** Whether an aid is used, from where, for how long; and why it is, or was lately, refused. */
function wordsOf(name, { state, source, since_s: since, refused_s: refused, why }) {
  if (name === "rest" && state === "lost") return "moving";
  if (state !== "used") return `${state}, ${source}${why && `: ${why}`}`;
  const lately = isKnown(refused) && refused < RECENT ? `; lately refused: ${why}` : "";
  return `used, ${source}, for ${fixed(since, 0)} s${lately}`;
}

/** The vehicle, and whether it is armed by its present heartbeat. */
function vehicleOf({ peer, link }, isNow) {
  if (!peer) return link.url;
  const name = `${peer.family} ${peer.version}, system ${peer.system_id}`;
  if (!isNow) return name;
  return peer.is_heard ? name + (peer.is_armed ? ", armed" : "") : `${name}, silent for ${fixed(peer.silent_s, 0, " s")}`;
}

function showState(status) {
  const { health, peer, estimator, output, process, imu, link, preflight, time } = status;
  showPreflight(status);
  const one = (name, text) => [name, text, "now"]; // not of the estimate: as new as the page
  put("vehicle", vehicleOf(status, true));
  const resets = Object.entries(status.resets).map(([why, n]) => `${why} ${n}`).join(", ");
  const isOld = !(status.sample_age_s < OLD);
  const words = estimator?.status.replace("_", " ");
  const found = !estimator ? "none yet" : isOld ? `none for ${fixed(status.sample_age_s, 0, " s")}; the last was ${words}` : words;
  showFacts([
    ["estimate", found, !estimator ? "" : estimator.status === "ok" && !isOld ? "good" : "bad"],
    ["ODOMETRY", output.is_allowed ? `${fixed(output.rate, 0)} Hz${output.silence ? `, ${output.silence}` : ""}` : `withheld: ${output.reason}`],
    ["to change", output.remedy],
    ["samples", `${imu.message || "none"}, ${fixed(imu.rate, 0)} Hz`],
    ...Object.entries(imu.units ?? {}).map(([number, words]) => [`inertial unit ${number}`, words]),
    ["age of the newest", fixed(status.sample_age_s, 1, " s"), isOld ? "bad" : ""],
    ...Object.entries(status.vehicle?.aids ?? {}).filter(([, aid]) => aid.state !== "none").map(([name, aid]) => [
      name, wordsOf(name, aid), aid.state === "used" || name === "rest" ? "" : "bad"]),
    ["sigma", estimator ? `${fixed(estimator.std_horizontal, 2)} m horizontal, ${fixed(estimator.std_vertical, 2)} m vertical` : ""],
    ["protection level", isKnown(estimator?.protection_horizontal) ? `${fixed(estimator.protection_horizontal, 1)} m horizontal, ${fixed(estimator.protection_vertical, 1)} m vertical` : ""],
    ["suspected", (estimator?.suspected ?? []).join("; "), "bad"],
    ["may be wrong", probabilities(estimator)],
    ["faults found", (estimator?.found ?? []).join("; "), "bad"],
    ["resets", resets || "none", resets ? "bad" : ""],
    ["link", `${link.url}${link.is_open ? "" : ", closed"}`, link.is_open ? "now" : "bad"],
    ["lost frames", String(status.frames.lost)],
    ["clock", time.is_locked ? `locked, round trip ${fixed(time.rtt_p50_ms, 1)} ms` : time.trouble || "not locked"],
    ["recording", process.recording_trouble || (process.recorded_bytes ? `${fixed(process.recorded_bytes / 1e6, 1)} MB` : "none"), process.recording_trouble ? "bad" : "now"],
    one("processor", `${fixed(100 * process.cpu_share, 1)} % of a core, ${fixed(process.rss_mb, 0)} MB`),
    one("temperature", Object.entries(process.temperatures).map(([name, c]) => `${name} ${fixed(c, 0)} \u00b0C`).slice(0, 3).join(", ")),
    one("running for", `${fixed(process.uptime_s, 0)} s, version ${process.version}`),
  ]);
  showStages(status);
  showRates(status.messages, isOld);
}

/** How probable it is of each source that it is wrong, from a hundredth on. */
function probabilities(estimator) {
  return Object.entries(estimator?.faults ?? {}).filter(([, p]) => p >= 0.01).sort(([, a], [, b]) => b - a)
    .map(([source, p]) => `${source.replaceAll("_", " ")} ${fixed(100 * p, 0)} %`).join(", ");
}

/** The verdict before take-off; after it, whether all works. */
function showPreflight({ health, peer, preflight, estimator, sample_age_s: age }) {
  const isAsked = preflight && !peer?.is_armed;
  if (health.is_ok && !(age < OLD)) {
    const words = `no inertial sample has come for ${fixed(age, 1, " s")}`;
    return showVerdict("wait", isAsked ? "not ready for take-off" : `no estimate; ${words}`, isAsked ? [words] : []);
  }
  const isGood = isAsked ? preflight.ready : health.is_ok && estimator?.status === "ok";
  const kind = !health.is_healthy ? "bad" : isGood ? "good" : "wait";
  if (!isAsked) return showVerdict(kind, health.words);
  const sentence = preflight.ready ? "ready for take-off" : "not ready for take-off";
  const notes = (preflight.notes ?? []).map((one) => `(${one})`);
  return showVerdict(kind, sentence, [...preflight.reasons, ...notes], health.words);
}

/** Counters stage by stage, and what became of each aid. */
function showStages({ link, frames, estimator, output }) {
  const arrivals = estimator?.arrivals ?? {};
  const all = (why) => Object.values(arrivals).reduce((sum, one) => sum + (one[why] ?? 0), 0);
  const bad = (count) => [count.toLocaleString("en"), count ? "bad" : ""];
  const good = (count) => count.toLocaleString("en");
  showTable("counts", ["stage", "passed", "lost or refused"], [
    ["bytes", good(link.bytes_in), bad(link.dropped)],
    ["frames", good(frames.frames), bad(frames.lost + frames.bad_crc)],
    ["measurements", good(all("taken") + all("estimated")), bad(all("malformed") + all("stale"))],
    ["inertial samples", good(estimator?.samples ?? 0), [`${estimator?.gaps ?? 0} gaps`, estimator?.gaps ? "bad" : ""]],
    ["ODOMETRY", good(output.sent.ODOMETRY ?? 0), bad(output.unsent + output.withheld)],
  ]);
  const verdicts = estimator?.verdicts ?? {};
  const shown = VERDICTS.filter((why) => Object.values(verdicts).some((counts) => counts[why]));
  showTable("stages", [Object.keys(verdicts).length ? "aid" : "", ...shown.map((why) => why.replace("_", " "))],
    Object.entries(verdicts).map(([aid, counts]) => [aid, ...shown.map((why) => [String(counts[why] ?? 0), why === "gated" && counts[why] ? "bad" : ""])]));
}

function showRates(messages, isOld) {
  const asked = ([, one]) => (one.asked ? 0 : 1);
  showTable("rates", ["message", "asked", "got", "answer"],
    Object.entries(messages).filter(([, one]) => one.asked || one.rate > 0.05).sort((a, b) => asked(a) - asked(b)).map(([name, one]) => [
      name, one.asked ? fixed(one.asked, 0) : "", [fixed(one.rate, 1), one.cause || (isOld && one.asked && one.rate < 0.05) ? "bad" : ""], one.cause || one.answer]));
}
