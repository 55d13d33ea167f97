// Small pieces of the page. Text only ever goes in as text: what comes from a bus is not trusted.

import { SIGNS, UNKNOWN, kind } from "./words.js";

export function element(tag, name = "", text = "") {
  const made = document.createElement(tag);
  if (name) made.className = name;
  if (text) made.textContent = text;
  return made;
}

export function write(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

// Flags in a row: a sign, a word, and before them what the flag is of, if the word does not say.
export class Flags {
  constructor(parent) {
    this.parent = parent;
    this.made = new Map();
  }

  set(key, label, word, known = true) {
    let flag = this.made.get(key);
    if (!flag) {
      flag = element("span", "flag");
      flag.dataset.key = key;
      this.parent.append(flag);
      this.made.set(key, flag);
    }
    const shown = known && word !== null && word !== undefined ? word : "Unknown";
    const how = kind(shown);
    write(flag, `${SIGNS[how]} ${label ? `${label} ` : ""}${shown}`);
    if (flag.className !== `flag ${how}`) flag.className = `flag ${how}`;
  }
}

const WIDE = new Set(["detector", "fault", "causes"]);

// Names and values; an odd one is marked. Unless known, all values are shown as unknown.
export class Values {
  constructor(parent) {
    this.parent = parent;
    this.made = new Map();
    this.known = false;
  }

  set(key, label, value, unit = "", odd = false) {
    const shown = this.known && value !== null ? value : UNKNOWN;
    let cell = this.made.get(key);
    if (!cell) {
      const pair = element("div", WIDE.has(key) ? "wide" : "");
      const text = element("span");
      cell = { dd: element("dd"), text, unit: element("small") };
      cell.dd.dataset.key = key;
      cell.dd.append(text, cell.unit);
      pair.append(element("dt", "", label), cell.dd);
      this.parent.append(pair);
      this.made.set(key, cell);
    }
    write(cell.text, shown);
    write(cell.unit, unit && shown !== UNKNOWN ? ` ${unit}` : "");
    cell.dd.classList.toggle("odd", this.known && odd);
  }
}
