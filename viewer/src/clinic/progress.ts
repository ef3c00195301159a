/** A job as it goes: the server sends what it does, and the page is loaded again when it has ended. */

import { loggedIn } from "./login";

const AGAIN_MS = 3000;

interface Job {
  id: string;
  state: string;
  place: number | null;
  stage_words: string;
  fraction: number | null;
}

export function followJobs(): void {
  for (const place of document.querySelectorAll<HTMLElement>("[data-events]")) follow(place);
}

function follow(place: HTMLElement): void {
  const events = new EventSource(place.dataset.events!);
  events.addEventListener("job", (event) => {
    const job = JSON.parse((event as MessageEvent<string>).data) as Job;
    const own = place.querySelector<HTMLElement>(`[data-job="${job.id}"]`) ?? place.querySelector<HTMLElement>("[data-job-any]");
    if (own !== null) show(own, job);
    else if (place.dataset.whole !== undefined && !["done", "failed", "cancelled"].includes(job.state)) window.location.reload();
  });
  events.addEventListener("end", () => {
    events.close();
    window.location.reload();
  });
  events.addEventListener("error", () => {
    if (events.readyState !== EventSource.CLOSED) return; // it connects again by itself
    setTimeout(() => void loggedIn().then((back) => back && follow(place), () => undefined), AGAIN_MS);
  });
  window.addEventListener("pagehide", () => events.close());
}

function show(place: HTMLElement, job: Job): void {
  const words = place.querySelector<HTMLElement>("[data-words]");
  const bar = place.querySelector<HTMLProgressElement>("progress");
  const said = wordsOf(job);
  if (words !== null && words.textContent !== said) words.textContent = said;
  if (bar !== null) {
    if (job.state === "queued") bar.value = 0;
    else bar.value = job.fraction ?? 0;
  }
  if (["done", "failed", "cancelled"].includes(job.state) && place.dataset.state !== job.state) window.location.reload();
  place.dataset.state = job.state;
}

function wordsOf(job: Job): string {
  if (job.state === "queued") return job.place === null || job.place < 2 ? "Waiting: it is next." : `Waiting: number ${job.place} in the queue.`;
  if (job.state === "running") return `${job.stage_words} (${Math.round(100 * (job.fraction ?? 0))} %)`;
  return { done: "Done.", failed: "It could not be finished.", cancelled: "Cancelled." }[job.state] ?? job.state;
}
