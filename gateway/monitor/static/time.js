// Play, pause, seek and speed of a log; of a bus only a picture that stands still.

import { write } from "./parts.js";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10];
const AGAIN_MS = 100;
// A slider that somebody holds is not moved by what the server says.
const HELD_MS = 600;

export class TimeBar {
  constructor(ask, freeze) {
    this.ask = ask;
    this.freeze = freeze;
    this.box = document.getElementById("time");
    this.play = document.getElementById("play");
    this.slider = document.getElementById("slider");
    this.speed = document.getElementById("speed");
    this.text = document.getElementById("span");
    this.head = null;
    this.still = false;
    this.heldMs = -Infinity;
    this.askedMs = -Infinity;
    this.later = 0;
    for (const speed of SPEEDS) this.speed.append(new Option(`× ${speed}`, speed));
    this.play.addEventListener("click", () => this.toggle());
    this.slider.addEventListener("input", () => this.dragged());
    this.speed.addEventListener("change", () => this.ask({ speed: Number(this.speed.value) }));
    for (const button of this.box.querySelectorAll("[data-step]")) {
      button.addEventListener("click", () => this.step(Number(button.dataset.step)));
    }
    document.addEventListener("keydown", (event) => this.key(event));
  }

  draw(head) {
    this.head = head;
    this.box.hidden = false;
    const paused = head.live ? this.still : head.paused;
    write(this.play, paused ? "Play" : "Pause");
    this.play.setAttribute("aria-pressed", String(paused));
    for (const part of [this.slider, this.text, this.speed.parentElement,
      this.box.querySelector(".steps")]) part.hidden = head.live;
    if (head.live) return;
    const end = head.span_s[1];
    this.slider.max = end;
    if (performance.now() - this.heldMs > HELD_MS && !head.behind) this.slider.value = head.t_s;
    this.told(Number(this.slider.value));
    if (document.activeElement !== this.speed) this.choose(head.speed);
  }

  // A speed that the command line asked for need not be one of ours.
  choose(speed) {
    if (![...this.speed.options].some((option) => Number(option.value) === speed)) {
      this.speed.append(new Option(`× ${speed}`, speed));
    }
    this.speed.value = String(speed);
  }

  told(t_s) {
    const end = this.head.span_s[1].toFixed(1);
    write(this.text, `${t_s.toFixed(1)} of ${end} s`);
    this.slider.setAttribute("aria-valuetext", `${t_s.toFixed(1)} seconds of ${end}`);
  }

  toggle() {
    if (!this.head) return;
    if (this.head.live) {
      this.still = !this.still;
      this.freeze(this.still);
      this.draw(this.head);
      return;
    }
    // At the end, play means again from the start.
    if (!this.head.paused && this.head.t_s >= this.head.span_s[1] - 0.05) this.seek(0);
    else this.ask({ pause: !this.head.paused });
  }

  step(seconds) {
    if (this.head && !this.head.live) this.seek(Number(this.slider.value) + seconds);
  }

  dragged() {
    this.seek(Number(this.slider.value));
  }

  // Not more often than the server looks; the last one always goes out.
  seek(t_s) {
    const wanted = Math.min(Math.max(t_s, 0), this.head.span_s[1]);
    this.slider.value = wanted;
    this.told(wanted);
    this.heldMs = performance.now();
    clearTimeout(this.later);
    const wait = this.askedMs + AGAIN_MS - performance.now();
    const go = () => {
      this.askedMs = performance.now();
      this.ask({ seek: wanted });
    };
    if (wait > 0) this.later = setTimeout(go, wait);
    else go();
  }

  key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    // Those have a use of their own for it; the slider has none.
    if (event.target.closest("button, select, a, [tabindex='0']") && event.key === " ") return;
    if (event.key === " ") {
      event.preventDefault();
      this.toggle();
    } else if (event.key === ",") this.step(-1);
    else if (event.key === ".") this.step(1);
  }
}
