/** A volume in words, with the digits that the visit's page and the report write. */

import type { Job, LiveVolume } from "./drawing";

/** The number with its interval. */
export function volumeWords({ volumeCc, intervalCc }: LiveVolume, signed: boolean): (string | HTMLElement)[] {
  if (volumeCc === null) return [];
  const coarse = signed || (intervalCc !== null && intervalCc[1] - intervalCc[0] >= 10);
  const digits = (value: number): string => value.toFixed(coarse ? 0 : 1);
  const value = document.createElement("b");
  value.textContent = `${digits(volumeCc)} cc`;
  return intervalCc === null ? [value] : [value, ` 95 %: ${digits(intervalCc[0])} to ${digits(intervalCc[1])} cc`];
}

/** Whether the number is measured; undefined: it is not known yet. */
export function volumeNote(volume: LiveVolume | undefined, drawn: boolean, job: Job | null): HTMLElement {
  const note = document.createElement("span");
  note.className = "mm-note";
  if (volume === undefined || volume.volumeCc === null) {
    note.textContent = drawn && volume === undefined ? "…" : "no volume";
    return note;
  }
  note.dataset.preliminary = String(volume.preliminary);
  if (!volume.preliminary) note.textContent = "measured";
  else if (job === null) note.textContent = "preliminary, until it is measured";
  else {
    const part = job.state === "running" ? ` (${Math.round(100 * (job.fraction ?? 0))} %)` : "";
    note.textContent = `preliminary: being measured${part}`;
  }
  return note;
}
