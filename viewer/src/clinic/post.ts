/** Buttons that ask the server for something and then show its page anew. */

import { hold } from "./forms";
import { Refused, request } from "./request";

interface Made {
  id?: string;
}

export function postForms(): void {
  document.addEventListener("submit", (event) => {
    const form = event.target as HTMLFormElement;
    if (form.dataset.post === undefined || event.defaultPrevented) return;
    event.preventDefault();
    if (form.ariaBusy === "true") return;
    const release = hold(form);
    const token = form.querySelector<HTMLInputElement>("input[name=form_token]")?.value;
    const said = form.querySelector<HTMLElement>("[data-said]");
    void post(form.action, said, form.dataset, {}, token).then((status) => status === 200 || release());
  });
}

/** Ask; then show the page that comes next, or the page of what was made, or this one anew. A refusal is shown beside the button. */
export async function post(
  address: string,
  said: HTMLElement | null,
  then: { next?: string; open?: string } = {},
  body: object = {},
  token?: string,
): Promise<number> {
  try {
    const reply = await request<Made>(address, { json: body, headers: token === undefined ? {} : { "Form-Token": token } });
    if (then.open !== undefined && reply.id !== undefined) window.location.assign(`${then.open}${reply.id}/`);
    else if (then.next !== undefined) window.location.assign(then.next);
    else window.location.reload();
    return 200;
  } catch (error) {
    const refused = error instanceof Refused ? error : null;
    if (said !== null) said.textContent = refused?.message ?? "The clinic cannot be reached. Try again in a moment.";
    return refused?.status ?? 0;
  }
}
