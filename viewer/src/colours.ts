/** Colours that people with any colour vision tell apart, and what they mean. */

import { Color } from "three";

import type { Layer } from "./format";

/** Even in lightness, readable without colour vision (after cividis, Nuñez et al. 2018). */
const SEQUENTIAL = ["#00224e", "#123570", "#3b496c", "#575d6d", "#707173", "#8a8678", "#a59c74", "#c3b369", "#e1cc55", "#fee838"];
/** Blue for below, orange for above, near white for none. */
const DIVERGING = ["#08407e", "#2a78b5", "#7ab3d8", "#c9dfec", "#f4f3f0", "#f6d3ae", "#e79b56", "#c65f14", "#7f3507"];
const MISSING = "#9a9a9a";

const ramps = new Map(
  (
    [
      ["sequential", SEQUENTIAL],
      ["diverging", DIVERGING],
    ] as const
  ).map(([kind, stops]) => [kind, stops.map((stop) => new Color(stop))]),
);

/** One colour a vertex, linear RGB, as the renderer wants it. */
export function layerColours(layer: Layer): Float32Array {
  const colours = new Float32Array(3 * layer.values.length);
  const categories = layer.categories.map((category) => new Color(category.colour));
  const missing = new Color(MISSING);
  const colour = new Color();
  layer.values.forEach((value, k) => {
    if (layer.kind === "category") colour.copy(categories[value] ?? missing);
    else if (Number.isNaN(value)) colour.copy(missing);
    else ramp(layer.kind, (value - layer.low) / (layer.high - layer.low), colour);
    colour.toArray(colours, 3 * k);
  });
  return colours;
}

/** A legend: the scale with its ends and unit, or the categories by name. */
export function legend(layer: Layer): HTMLElement {
  const box = document.createElement("div");
  box.className = "mm-legend";
  if (layer.kind === "category") {
    for (const category of layer.categories) {
      const entry = box.appendChild(document.createElement("span"));
      const patch = entry.appendChild(document.createElement("i"));
      patch.style.background = category.colour;
      entry.append(category.title);
    }
    return box;
  }
  const stops = layer.kind === "sequential" ? SEQUENTIAL : DIVERGING;
  const bar = document.createElement("i");
  bar.className = "mm-bar";
  bar.style.background = `linear-gradient(to right, ${stops.join(", ")})`;
  box.append(`${number(layer.low)} `, bar, ` ${number(layer.high)} ${layer.unit}`);
  if (layer.values.some(Number.isNaN)) {
    const entry = box.appendChild(document.createElement("span"));
    const patch = entry.appendChild(document.createElement("i"));
    patch.style.background = MISSING;
    entry.append("no value");
  }
  return box;
}

/** A layer's value in words. */
export function valueWords(layer: Layer, vertex: number): string {
  const value = layer.values[vertex]!;
  if (layer.kind === "category") return layer.categories[value]?.title ?? "unknown";
  return Number.isNaN(value) ? "no value" : `${number(value)} ${layer.unit}`;
}

/** A number with the digits that a reader needs, and a true minus sign. */
export function number(value: number): string {
  const size = Math.abs(value);
  return value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : 2).replace("-", "−");
}

function ramp(kind: "sequential" | "diverging", share: number, into: Color): Color {
  const stops = ramps.get(kind)!;
  const at = Math.min(Math.max(share, 0), 1) * (stops.length - 1);
  const below = Math.min(Math.floor(at), stops.length - 2);
  return into.copy(stops[below]!).lerp(stops[below + 1]!, at - below);
}
