/** Puts one moment into the page: numbers, horizon, map and tables, the same live and for a log. */

import { $, fixed, isKnown, make, put, turn } from "./format.js";
import { drawHorizon } from "./horizon.js";

const APART_TOO_FAR = { roll: 5, pitch: 5, heading: 15, place: 10, alt: 10, speed: 2 };

/** Show our estimate and the autopilot's. */
export function showSample(sample, autopilot, map, kind) {
  drawHorizon(sample, autopilot);
  for (const name of ["roll", "pitch", "heading"]) {
    const [ours, theirs] = [sample?.[`${name}_deg`], autopilot?.[`${name}_deg`]];
    row(name, fixed(ours, 1, "\u00b0"), fixed(sample?.sigma?.[`${name}_deg`], 1, "\u00b0"), fixed(theirs, 1, "\u00b0"),
      isKnown(ours) && isKnown(theirs) ? turn(ours, theirs) : NaN, "\u00b0", APART_TOO_FAR[name]);
  }
  map.show(sample, autopilot, kind);
  const [now, beside] = [map.now, map.beside];
  const apart = now && beside ? [now[0] - beside[0], now[1] - beside[1]] : [NaN, NaN];
  row("lat", fixed(sample?.lat_deg, 6, "\u00b0"), fixed(sample?.sigma?.north_m, 2, " m"), fixed(autopilot?.lat_deg, 6, "\u00b0"), apart[1], " m", APART_TOO_FAR.place);
  row("lon", fixed(sample?.lon_deg, 6, "\u00b0"), fixed(sample?.sigma?.east_m, 2, " m"), fixed(autopilot?.lon_deg, 6, "\u00b0"), apart[0], " m", APART_TOO_FAR.place);
  row("alt", fixed(sample?.alt_m, 1, " m"), fixed(sample?.sigma?.alt_m, 2, " m"), fixed(autopilot?.alt_m, 1, " m"),
    (sample?.alt_m ?? NaN) - (autopilot?.alt_m ?? NaN), " m", APART_TOO_FAR.alt);
  const [ours, theirs] = [speedOf(sample), speedOf(autopilot)];
  row("speed", fixed(ours, 2, " m/s"), fixed(sigmaOfSpeed(sample), 2, " m/s"), fixed(theirs, 2, " m/s"), ours - theirs, " m/s", APART_TOO_FAR.speed);
}

export function speedOf(sample) {
  const velocity = sample?.vel_ned_m_s;
  return velocity && isKnown(velocity[0]) ? Math.hypot(velocity[0], velocity[1]) : NaN;
}

/** Along the way; of a vehicle that stands, the larger of both horizontal ones. */
function sigmaOfSpeed(sample) {
  const [speed, [north, east] = [], [sdNorth, sdEast] = []] = [speedOf(sample), sample?.vel_ned_m_s, sample?.sigma?.vel_ned_m_s];
  if (!isKnown(sdNorth) || !isKnown(sdEast)) return NaN;
  return speed > 0.5 ? Math.hypot(north * sdNorth, east * sdEast) / speed : Math.max(sdNorth, sdEast);
}

function row(name, ours, sigma, theirs, apart, unit, limit) {
  put(name, ours);
  put(`sigma-${name}`, sigma);
  put(`autopilot-${name}`, theirs);
  put(`apart-${name}`, fixed(apart, 1, unit), Math.abs(apart) > limit ? "bad" : "");
}

/** Show the verdict, which is good, wait or bad, with its reasons. */
export function showVerdict(kind, sentence, reasons = [], health = "") {
  $("verdict").className = kind;
  put("sentence", sentence);
  put("health", health);
  if ($("reasons").dataset.text !== reasons.join("\n")) {
    $("reasons").dataset.text = reasons.join("\n");
    $("reasons").replaceChildren(...reasons.map((reason) => make("li", reason)));
  }
}

/** Show names and values; an entry may be marked good or bad. */
export function showFacts(facts) {
  const known = facts.filter(([, text]) => text);
  $("facts").replaceChildren(
    ...known.flatMap(([name, text, kind]) => [make("dt", name), make("dd", text, kind ?? "")]),
  );
}

/** Fill a table with a head and rows; a cell is a text, or a text and good or bad. */
export function showTable(id, head, rows) {
  const cell = (tag, content) => make(tag, ...(Array.isArray(content) ? content : [String(content)]));
  $(id).replaceChildren(
    make("thead", "", "", [make("tr", "", "", head.map((text) => cell("th", text)))]),
    make("tbody", "", "", rows.map(([name, ...cells]) =>
      make("tr", "", "", [cell("th", name), ...cells.map((one) => cell("td", one))]))),
  );
}

/** Show events, the newest first: time as text, level, text. */
export function showEvents(events) {
  if (!events.length) return $("events").replaceChildren(make("li", "none yet", "note"));
  return $("events").replaceChildren(
    ...events.toReversed().map(({ time, level, text }) =>
      make("li", "", level, [make("time", time), document.createTextNode(text)])),
  );
}
