/* Two lists that can be clicked: what the chain said and what somebody should look at, both up to the step shown. */

import { $, clock, count, countUpTo, html, inUnits } from "./words.js";

const SHOWN = 80;
const MOST_ALERTS = 30;

export class Lists {
  /* go(step, member) jumps to a step and picks a member: { kind, index }, or null. */
  constructor(run, go, changed) {
    this.run = run;
    this.go = go;
    this.matching = [];
    this.scanned = 0;
    this.key = "";
    this.alertKey = "";
    this.kind = "";
    this.member = "";
    this.kinds = new Map();
    this.changed = changed;
    this.refilter();
    $("event-name").onchange = () => { this.kind = $("event-name").value; this.refilter(); changed(); };
    $("event-member").oninput = () => { this.member = $("event-member").value; this.refilter(); changed(); };
  }

  set(kind, member) {
    this.kind = kind;
    this.member = member;
    $("event-member").value = member;
    this.refilter();
    $("event-name").value = kind;
  }

  refilter() {
    this.matching = [];
    this.scanned = 0;
    this.kinds.clear();
    this.key = "";
    this.#scan();
  }

  /* Looks at the events that have come since; a live run forgets old ones, and then all are looked at again. */
  #scan() {
    const { run } = this;
    const wanted = this.member.trim().toLowerCase();
    if (run.live && run.events[0] !== this.oldest) {
      this.oldest = run.events[0];
      this.matching = [];
      this.kinds.clear();
      this.scanned = 0;
    }
    const before = this.kinds.size;
    for (; this.scanned < run.eventCount(); this.scanned++) {
      const { name, parts } = run.event(this.scanned);
      this.kinds.set(name, (this.kinds.get(name) ?? 0) + 1);
      if (this.kind && name !== this.kind) continue;
      if (wanted && !parts.some((part, k) => k % 2 && part.toLowerCase().includes(wanted))) continue;
      this.matching.push(this.scanned);
    }
    if (before !== this.kinds.size || !$("event-name").options.length) {
      const options = [html("option", { value: "", textContent: "all kinds" })];
      for (const name of [...this.kinds.keys()].sort()) {
        options.push(html("option", { value: name, textContent: run.live ? name : `${name} (${this.kinds.get(name)})` }));
      }
      $("event-name").replaceChildren(...options);
      $("event-name").value = this.kind;
    }
  }

  draw(at) {
    const { run, matching } = this;
    if (run.live) this.#scan();
    const shown = countUpTo(at, matching.length, (k) => run.event(matching[k]).step);
    const key = `${shown}:${matching[shown - 1]}:${this.kind}:${this.member}`;
    if (key !== this.key) {
      this.key = key;
      $("event-count").textContent = count(shown) + (shown > SHOWN ? `, newest ${SHOWN}` : "");
      const rows = [];
      for (let k = shown - 1; k >= Math.max(0, shown - SHOWN); k--) rows.push(this.#row(run.event(matching[k])));
      if (!rows.length) rows.push(html("li", { className: "none", textContent: "No such event up to here." }));
      $("events").replaceChildren(...rows);
    }
    this.#alerts(at);
  }

  #row({ step, block, name, parts }) {
    const row = html("li", {});
    const button = html("button", { type: "button" }, row);
    html("time", { textContent: clock(this.run, step), title: "block " + block }, button);
    html("b", { textContent: name }, button);
    const line = html("span", { className: "parts" }, button);
    for (let p = 0; p + 1 < parts.length; p += 2) {
      const pair = html("span", {}, line);
      html("i", { textContent: parts[p] + " " }, pair);
      const value = inUnits(parts[p], parts[p + 1]);
      const long = value.length > 40 && !value.includes(" ");
      pair.append(long ? value.slice(0, 12) + "…" + value.slice(-8) : value);
      if (long || value !== parts[p + 1]) pair.title = `${parts[p]} ${parts[p + 1]}`;
    }
    button.addEventListener("click", () => this.go(step, this.memberOf(parts)));
    return row;
  }

  /* The first argument that is a member of the fleet or a vehicle. */
  memberOf(parts) {
    for (let p = 1; p < parts.length; p += 2) {
      for (const kind of ["vehicle", "uav"]) {
        const index = this.run.find(kind, parts[p]);
        if (index >= 0) return { kind, index };
      }
    }
    return null;
  }

  #alerts(at) {
    const { alerts } = this.run;
    const shown = countUpTo(at, alerts.length, (k) => alerts[k].step);
    const key = `${shown}:${alerts[shown - 1]?.step}`;
    if (key === this.alertKey) return;
    this.alertKey = key;
    $("alert-count").textContent = count(shown);
    $("alerts").closest("section").classList.toggle("some", shown > 0);
    const rows = [];
    for (let k = shown - 1; k >= Math.max(0, shown - MOST_ALERTS); k--) {
      const { step, kind, about, text } = alerts[k];
      const row = html("li", {});
      const button = html("button", { type: "button", className: kind }, row);
      html("time", { textContent: clock(this.run, step) }, button);
      button.append(text);
      button.addEventListener("click", () => this.go(step, this.memberOf(["", about])));
      rows.push(row);
    }
    if (!rows.length) rows.push(html("li", { className: "none", textContent: "None up to here." }));
    $("alerts").replaceChildren(...rows);
  }
}
