/** What cannot be taken back is asked first. */

export function askFirst(): void {
  document.addEventListener("submit", (event) => {
    const submitter = event.submitter as HTMLElement | null;
    const question = submitter?.dataset.ask ?? (event.target as HTMLElement).dataset.ask;
    if (question !== undefined && !window.confirm(question)) event.preventDefault();
  });
}
