/** The rig's form: a picture of the board as it is typed, and more rows for pairs. */

const PAUSE_MS = 250; // after the last key

export function drawBoard(): void {
  document.querySelector<HTMLElement>("[data-show-more]")?.addEventListener("click", (event) => {
    for (const row of document.querySelectorAll<HTMLElement>("[data-more]")) row.hidden = false;
    (event.currentTarget as HTMLElement).hidden = true;
  });
  const part = document.querySelector<HTMLElement>("[data-board]");
  if (part === null) return;
  const picture = part.querySelector<HTMLImageElement>("[data-board-picture]")!;
  const said = part.querySelector<HTMLElement>("[data-board-said]")!;
  let waiting = 0;
  const draw = async (): Promise<void> => {
    const typed = new URLSearchParams();
    for (const field of part.querySelectorAll<HTMLInputElement | HTMLSelectElement>("input, select")) typed.set(field.name, field.value);
    const marked = typed.get("board") === "charuco";
    for (const name of ["marker_mm", "dictionary"]) part.querySelector<HTMLElement>(`[name=${name}]`)!.closest<HTMLElement>(".field")!.hidden = !marked;
    const address = `${part.dataset.board!}?${typed.toString()}`;
    const answer = await fetch(address, { headers: { Accept: "image/svg+xml" } }).catch(() => null);
    picture.hidden = answer?.ok !== true;
    said.textContent = answer === null || answer.ok ? "" : answer.status === 422 ? "The board is drawn when its sizes are entered." : "";
    if (answer?.ok === true) picture.src = address;
  };
  part.addEventListener("input", () => {
    window.clearTimeout(waiting);
    waiting = window.setTimeout(() => void draw(), PAUSE_MS);
  });
  void draw();
}
