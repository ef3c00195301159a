/** Buttons that ask the server for something and then show its page anew. */

interface Answer {
  url?: string;
  error?: string;
}

export function postForms(): void {
  document.addEventListener("submit", (event) => {
    const form = event.target as HTMLFormElement;
    if (form.dataset.post === undefined || event.defaultPrevented) return;
    event.preventDefault();
    void post(form.action, form.dataset.token!, form.querySelector<HTMLElement>("[data-said]"), form.dataset.next);
  });
}

/** Ask; an answer with an address leads there, a refusal is told beside the button. */
export async function post(address: string, token: string, said: HTMLElement | null, next?: string, body: object = {}): Promise<void> {
  try {
    const response = await fetch(address, {
      method: "POST",
      headers: { "X-CSRFToken": token, "Content-Type": "application/json", Accept: "application/json" },
      body: JSON.stringify(body),
    });
    const told = (await response.json().catch(() => ({}))) as Answer;
    if (response.ok) {
      if (told.url !== undefined && next === undefined) window.location.assign(told.url);
      else if (next !== undefined) window.location.assign(next);
      else window.location.reload();
    } else if (said !== null) said.textContent = told.error ?? "That did not work. Load the page again.";
  } catch {
    if (said !== null) said.textContent = "The clinic cannot be reached. Try again in a moment.";
  }
}
