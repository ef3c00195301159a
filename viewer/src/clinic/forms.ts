/** Forms are sent once, and into a session that lasts: where it has ended, the password is asked for first. */

import { forgetEverywhere, keep } from "./drafts";
import { loggedIn } from "./login";

const UNREACHABLE = "The clinic cannot be reached. Your entries are kept. Try again in a moment.";
const held = new Set<() => void>();

export function sendForms(): void {
  document.addEventListener("submit", (event) => {
    const form = event.target as HTMLFormElement;
    if (event.defaultPrevented || form.method !== "post" || form.dataset.post !== undefined) return;
    event.preventDefault();
    if (form.ariaBusy === "true") return;
    void send(form, event.submitter as HTMLButtonElement | null);
  });
  // A page that comes back as it was left can be used again.
  window.addEventListener("pageshow", (event) => {
    if (event.persisted) for (const release of [...held]) release();
  });
}

async function send(form: HTMLFormElement, submitter: HTMLButtonElement | null): Promise<void> {
  const path = new URL(form.action, window.location.href).pathname;
  const release = hold(form);
  form.querySelector(".unsent")?.remove();
  if (path === "/account/logout/") forgetEverywhere();
  else if (document.body.dataset.person !== undefined && !path.startsWith("/account/")) {
    keep(form);
    try {
      if (!(await loggedIn())) return release();
    } catch {
      release();
      return say(form, UNREACHABLE);
    }
    for (const token of document.querySelectorAll<HTMLInputElement>("input[name=csrfmiddlewaretoken]")) token.value = document.body.dataset.token!;
  }
  if (submitter?.name) {
    const pressed = document.createElement("input");
    Object.assign(pressed, { type: "hidden", name: submitter.name, value: submitter.value });
    form.append(pressed);
    held.add(() => pressed.remove());
  }
  HTMLFormElement.prototype.submit.call(form);
}

/** Disable a form's buttons. The answer enables them again. */
export function hold(form: HTMLFormElement): () => void {
  const buttons = [...form.elements].filter((each): each is HTMLButtonElement => each instanceof HTMLButtonElement && !each.disabled);
  const focused = document.activeElement;
  form.ariaBusy = "true";
  for (const button of buttons) button.disabled = true;
  const release = (): void => {
    form.ariaBusy = null;
    for (const button of buttons) button.disabled = false;
    if (buttons.includes(focused as HTMLButtonElement)) (focused as HTMLButtonElement).focus();
    held.delete(release);
  };
  held.add(release);
  return release;
}

function say(form: HTMLFormElement, text: string): void {
  const said = document.createElement("p");
  said.className = "said bad unsent";
  said.setAttribute("role", "alert");
  said.textContent = text;
  form.append(said);
}
