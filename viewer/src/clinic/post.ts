/** Buttons that ask the server for something and then show its page anew. */

interface Answer {
  id?: string;
  error?: string;
}

export function postForms(): void {
  document.addEventListener("submit", (event) => {
    const form = event.target as HTMLFormElement;
    if (form.dataset.post === undefined || event.defaultPrevented) return;
    event.preventDefault();
    void post(form.action, form.dataset.token!, form.querySelector<HTMLElement>("[data-said]"), form.dataset);
  });
}

/** Ask; then show the page that comes next, or the page of what was made, or this one anew. What is refused is reply beside the button. */
export async function post(
  address: string,
  token: string,
  said: HTMLElement | null,
  then: { next?: string; open?: string } = {},
  body: object = {},
): Promise<number> {
  try {
    const response = await fetch(address, {
      method: "POST",
      headers: { "X-CSRFToken": token, "Content-Type": "application/json", Accept: "application/json" },
      body: JSON.stringify(body),
    });
    const reply = (await response.json().catch(() => ({}))) as Answer;
    if (response.ok) {
      if (then.open !== undefined && reply.id !== undefined) window.location.assign(`${then.open}${reply.id}/`);
      else if (then.next !== undefined) window.location.assign(then.next);
      else window.location.reload();
    } else if (said !== null) said.textContent = reply.error ?? "That did not work. Load the page again.";
    return response.status;
  } catch {
    if (said !== null) said.textContent = "The clinic cannot be reached. Try again in a moment.";
    return 0;
  }
}
