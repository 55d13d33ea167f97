// Each panel of the page, drawn from what the server sends and from nothing else. known: false
// when that has become old; then nothing is shown as good.

import { Flags, Values, element, write } from "./parts.js";
import { Curves } from "./plots.js";
import { SIGNS, UNKNOWN, age, count, micros, number } from "./words.js";

const SET_FLAGS = [["common_mode", "common mode"], ["sensor_fault", "sensors"],
  ["comm_fault", "communication"], ["estimator_fault", "estimators"], ["overrun", "cycle"]];

function part(id, name) {
  return document.querySelector(`#${id} [data-part=${name}]`);
}

export class Gateway {
  constructor() {
    this.flags = new Flags(part("gateway", "flags"));
    this.values = new Values(part("gateway", "values"));
  }

  draw(row, known) {
    const { flags, values } = this;
    values.known = known;
    flags.set("state", "", row.state, known && (row.alive || row.source === "shadow"));
    for (const [name, label] of SET_FLAGS) flags.set(name, label, row[name], known);
    const troubled = (reason) => reason !== null && reason !== "None";
    values.set("reason", "reason", row.reason, "", troubled(row.reason));
    values.set("thermal_reason", "thermal reason", row.thermal_reason, "",
      troubled(row.thermal_reason));
    values.set("age", "oldest sample", number(row.age_ms, 0), "ms");
    values.set("detector", "detector", row.detector);
    values.set("misses", "ticks missed", count(row.deadline_misses), "", row.deadline_misses > 0);
    values.set("rejected", "frames rejected", count(row.rejected), "", row.rejected > 0);
    values.set("lost", "frames lost", count(row.lost_frames), "", row.lost_frames > 0);
    values.set("latency", "frame to flag, p99", micros(row.latency_p99_us));
    values.set("late", "ticks late, p99", micros(row.lateness_p99_us));
    values.set("load", "bus load, its word", number(row.bus_load_pct, 0), "%");
    values.set("hash", "configuration", row.config_hash);
    values.set("heartbeat", "heartbeat", row.heartbeat, "", row.heartbeat === "Silent");
  }
}

export class Bus {
  constructor() {
    this.flags = new Flags(part("bus", "flags"));
    this.values = new Values(part("bus", "values"));
  }

  draw(row, known) {
    const { flags, values } = this;
    values.known = known;
    flags.set("state", "", row.state, known);
    values.set("load", "load, measured", number(row.bus_load_pct, 1), "%", row.bus_load_pct > 80);
    values.set("frames", "frames", number(row.frames_s, 0), "/s");
    values.set("received", "received", count(row.received));
    values.set("errors", "error frames", count(row.error_frames), "", row.error_frames > 0);
    values.set("unread", "not read in time", count(row.unread), "", row.unread > 0);
    const causes = Object.entries(row.rejected);
    const text = causes.map(([cause, n]) => `${cause.replaceAll("_", " ")} ${n}`).join(", ");
    values.set("causes", "not used, by cause", text || "none", "", causes.length > 0);
  }
}

export class Lateness {
  constructor() {
    this.sum = part("lateness", "sum");
    this.table = document.querySelector("#lateness table");
    this.body = document.querySelector("#lateness tbody");
  }

  draw(late, known) {
    const there = known && late.counts.length > 0;
    this.table.hidden = !there;
    write(this.sum, there
      ? `99 %: ${micros(late.p99_us)} or less; largest ${micros(late.largest_us)}; ${late.total} flags`
      : "not known: no flags, or too few");
    if (!there) return;
    while (this.body.rows.length > late.counts.length) this.body.deleteRow(-1);
    while (this.body.rows.length < late.counts.length) {
      const row = this.body.insertRow();
      row.insertCell();
      row.insertCell();
      row.insertCell().append(element("span", "bar"));
    }
    const most = Math.max(...late.counts, 1);
    late.counts.forEach((n, k) => {
      const [edge, cell, bar] = this.body.rows[k].cells;
      write(edge, micros(late.edges_us[k + 1]));
      write(cell, String(n));
      bar.firstChild.style.width = `${(100 * n) / most}%`;
      bar.firstChild.hidden = n === 0;
    });
  }
}

class Drive {
  constructor(node) {
    this.box = element("article", "drive");
    this.box.dataset.node = node;
    const head = element("h2", "", `Drive ${node}`);
    head.id = `h-drive-${node}`;
    this.box.setAttribute("aria-labelledby", head.id);
    const [flags, values, plots] = [element("div", "flags"), element("dl"), element("div", "plots")];
    this.box.append(head, flags, values, plots);
    this.flags = new Flags(flags);
    this.values = new Values(values);
    this.curves = new Curves(plots, node);
  }

  draw(row, known) {
    const { flags, values } = this;
    values.known = known;
    flags.set("adhesion", "", row.adhesion, known);
    flags.set("thermal", "thermal", row.thermal, known);
    flags.set("health", "", row.health, known);
    const load = number(row.load_nm, 1);
    const sigma = number(row.load_sigma_nm, 1);
    values.set("speed", "speed, estimated", number(row.speed_rad_s, 1), "rad/s");
    values.set("measured", "speed, its word", number(row.measured_speed_rad_s, 1), "rad/s");
    values.set("load", "load torque", load === UNKNOWN ? UNKNOWN : `${load} ± ${sigma}`, "Nm");
    const lost = row.loss_probability;
    values.set("loss", "loss probability", number(lost === null ? null : 100 * lost, 0), "%");
    values.set("nis", "NIS", number(row.nis, 1));
    values.set("state", "state", row.state, "", row.state === "Fault");
    values.set("stator", "stator", number(row.stator_c, 1), "°C");
    values.set("de", "drive end", number(row.drive_end_c, 1), "°C");
    values.set("nde", "other end", number(row.non_drive_end_c, 1), "°C");
    values.set("mixed", "mixed state", number(row.mixed_c, 1), "°C");
    values.set("ambient", "ambient", number(row.ambient_c, 1), "°C");
    values.set("maisd", "MAISD", number(row.maisd_k, 2), "K");
    const grave = !["Unknown", "None"].includes(row.fault_class);
    const where = row.fault_sensor && row.fault_sensor !== "None" ? ` at ${row.fault_sensor}` : "";
    values.set("fault", "thermal fault", `${row.fault_class}${where}`, "", grave);
    values.set("trend", "trend", number(row.degradation_k_h, 3), "K/h");
    values.set("heartbeat", "heartbeat", row.heartbeat, "", row.heartbeat === "Silent");
    values.set("jumps", "jumps", count(row.jumps));
    values.set("rejected", "frames rejected", count(row.rejected), "", row.rejected > 0);
    values.set("age", "last heard", age(row.age_s));
  }
}

export class Drives {
  constructor() {
    this.box = document.getElementById("drives");
    this.made = new Map();
  }

  draw(rows, known) {
    for (const row of rows) {
      if (!this.made.has(row.node)) {
        const drive = new Drive(row.node);
        this.made.set(row.node, drive);
        this.box.append(drive.box);
      }
      this.made.get(row.node).draw(row, known);
    }
  }

  take({ fresh, t_s, drives }) {
    for (const [node, points] of Object.entries(drives)) {
      this.made.get(Number(node))?.curves.take(t_s, points, fresh);
    }
  }

  curves(what) {
    for (const drive of this.made.values()) drive.curves[what]();
  }
}

const LEVELS = { info: ["", "· info"], warning: ["flag warn", `${SIGNS.warn} warning`],
  error: ["flag bad", `${SIGNS.bad} error`] };

export class Events {
  constructor() {
    this.list = document.querySelector("#events ol");
    this.said = document.getElementById("said");
    this.last = "";
  }

  // The newest first. Only the newest error is said aloud, once.
  draw(events) {
    const lines = events.map((event) => {
      const line = element("li");
      const [how, level] = LEVELS[event.level] ?? LEVELS.info;
      const text = element("span");
      if (event.drive !== null) text.append(element("b", "", `drive ${event.drive}`), ": ");
      text.append(event.text);
      line.append(element("span", "", `${event.t_s.toFixed(2)} s`), element("span", how, level), text);
      return line;
    }).reverse();
    if (!lines.length) lines.push(element("li", "", "none so far"));
    this.list.replaceChildren(...lines);
    const worst = events.filter((event) => event.level === "error").at(-1);
    const text = worst ? `${worst.drive === null ? "" : `drive ${worst.drive} `}${worst.text}` : "";
    const key = worst ? `${worst.t_s} ${text}` : "";
    if (key !== this.last) write(this.said, text);
    this.last = key;
  }
}
