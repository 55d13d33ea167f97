// The page: one websocket in, panels out. Whatever is older than a moment is shown as unknown.

import { Bus, Drives, Events, Gateway, Lateness } from "./panels.js";
import { write } from "./parts.js";
import { TimeBar } from "./time.js";

const OLD_MS = 3000;
const LONGEST_WAIT_MS = 10000;
// As the server closes websockets: why, and whether trying again makes sense at once.
const CLOSED = {
  4013: "too many look at this monitor already",
  4009: "this page did not read in time",
  4008: "this page asked too often",
  4007: "this page asked for something that does not exist",
};

const $ = (id) => document.getElementById(id);
const panels = { gateway: new Gateway(), bus: new Bus(), lateness: new Lateness(),
  drives: new Drives(), events: new Events() };
let socket = null;
let head = null;
let heardMs = -Infinity;
let waitMs = 500;
let lostAt = null;
let why = "";
let frozen = false; // a bus goes on; only the picture stands still

const bar = new TimeBar((what) => {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(what));
}, (still) => { frozen = still; draw(); });

function known() {
  return socket?.readyState === WebSocket.OPEN && performance.now() - heardMs < OLD_MS;
}

function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/look`);
  let opened = false;
  socket.onopen = () => { opened = true; };
  socket.onmessage = ({ data }) => {
    const message = JSON.parse(data);
    heardMs = performance.now();
    waitMs = 500;
    lostAt = null;
    why = "";
    if (!frozen) take(message);
  };
  socket.onclose = async ({ code }) => {
    lostAt ??= new Date();
    why = CLOSED[code] ?? why;
    if (!opened && !why) why = await reason();
    draw();
    setTimeout(connect, waitMs);
    waitMs = Math.min(waitMs * 2, LONGEST_WAIT_MS);
  };
}

// Of a handshake that fails a script is not told why; of an ordinary request it is.
async function reason() {
  try {
    const answer = await fetch("/static/icon.svg", { cache: "no-store" });
    return answer.status === 401 ? "a token is required: open this page with /?token=… once" : "";
  } catch {
    return "";
  }
}

function take(message) {
  head = message.head;
  draw();
  if (message.events) panels.events.draw(message.events);
  if (message.points) panels.drives.take(message.points);
  panels.drives.curves("draw");
}

function draw() {
  const fresh = known();
  document.body.classList.toggle("old", !fresh);
  banner(fresh);
  if (!head) return;
  write($("kind"), head.live ? (frozen ? "BUS, frozen" : "BUS") : "LOG");
  write($("title"), head.title);
  write($("now"), fresh ? head.t_s.toFixed(1) : "?");
  document.title = `${fresh ? "" : "? "}${head.title} – traction-gateway`;
  bar.draw(head);
  panels.gateway.draw(head.gateway, fresh);
  panels.bus.draw(head.link, fresh);
  panels.lateness.draw(head.lateness, fresh);
  panels.drives.draw(head.drives, fresh);
}

function banner(fresh) {
  const box = $("banner");
  const [text, grave] = trouble(fresh);
  box.hidden = !text;
  box.classList.toggle("grave", grave);
  write(box, text);
}

function trouble(fresh) {
  if (!fresh && !lostAt && !head) return ["? connecting", false];
  if (!fresh) {
    const since = lostAt ? ` since ${lostAt.toLocaleTimeString()}` : "";
    return [`✗ no connection to the monitor${since}${why ? `: ${why}` : ""}; trying again`, true];
  }
  const { gateway } = head;
  if (frozen) return ["? the picture is frozen; the bus goes on", false];
  if (gateway.source === "shadow") {
    return ["? no gateway on this bus. SHADOW: flags and estimates are the monitor's own", false];
  }
  if (!gateway.present) return ["? no gateway on this bus", false];
  if (!gateway.alive) {
    const late = gateway.flags_age_ms;
    return [`✗ no flags of the gateway${late === null ? "" : ` for ${(late / 1000).toFixed(1)} s`}`, true];
  }
  return head.behind ? ["? seeking", false] : ["", false];
}

setInterval(() => { if (!known()) draw(); }, 500);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  panels.drives.curves("recolour");
});
connect();
