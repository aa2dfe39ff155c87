/* Figures in a reader's units, and small helpers for the document. Text of a run enters it by textContent only. */

export const $ = (id) => document.getElementById(id);

export function html(name, properties, parent) {
  const element = Object.assign(document.createElement(name), properties);
  parent?.append(element);
  return element;
}

export function svg(name, attributes, parent) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  parent?.append(element);
  return element;
}

export const number = (value, digits) => (Number.isFinite(value) ? value.toFixed(digits) : "–");
export const percent = (share) => (Number.isFinite(share) ? (100 * share).toFixed(1) + " %" : "–");
export const count = (value) => value.toLocaleString("en");

export function clock(run, step) {
  const seconds = Math.round(step * run.stepSeconds);
  const minutes = Math.floor(seconds / 60), rest = String(seconds % 60).padStart(2, "0");
  if (minutes < 60) return minutes + ":" + rest;
  return Math.floor(minutes / 60) + ":" + String(minutes % 60).padStart(2, "0") + ":" + rest;
}

/* How many of the sorted values are at most `limit`. */
export function countUpTo(limit, length, value) {
  let low = 0, high = length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (value(middle) <= limit) low = middle + 1; else high = middle;
  }
  return low;
}

const grouped = (value, digits) => value.toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits });

/* The contract's units (docs/reference/contract.md), by the argument's name. */
const UNITS = {
  x: (value) => grouped(value / 10, 1) + " m",
  y: (value) => grouped(value / 10, 1) + " m",
  uavX: (value) => grouped(value / 10, 1) + " m",
  uavY: (value) => grouped(value / 10, 1) + " m",
  maxDistance: (value) => grouped(value / 10, 1) + " m",
  altitude: (value) => grouped(value, 0) + " m",
  battery: (value) => grouped(value / 100, 2) + " %",
  reputation: (value) => grouped(value / 100, 2),
  initialReputation: (value) => grouped(value / 100, 2),
  bandwidth: (value) => grouped(value / 1000, 2) + " Mbit/s",
  demand: (value) => grouped(value / 1000, 2) + " Mbit/s",
  committed: (value) => grouped(value / 1000, 2) + " Mbit/s",
  maxBandwidth: (value) => grouped(value / 1000, 2) + " Mbit/s",
  maxDemand: (value) => grouped(value / 1000, 2) + " Mbit/s",
  payment: (value) => grouped(value, 0) + " cents per Mbit/s",
  maxPayment: (value) => grouped(value, 0) + " cents per Mbit/s",
  qou: (value) => grouped(value / QUALITY, 1),
  qov: (value) => grouped(value / QUALITY, 1),
  score: (value) => grouped(value / (100 * QUALITY), 3),
};
const QUALITY = 1e15;

export function inUnits(name, text) {
  const unit = UNITS[name];
  return unit && /^-?\d{1,21}$/.test(text) ? unit(Number(text)) : text;
}
