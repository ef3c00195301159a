/** The session has ended while somebody works: the password is asked for here, and nothing on the page is lost. */

interface Session {
  token: string;
  person: string | null;
}

const LOGIN = "/account/login/";
const CODE = "/account/code/";
const TOKEN = "/account/token/";
const ENDED = "Your session has ended. Enter your password to continue. Nothing on this page is lost.";

let asking: Promise<boolean> | null = null;

/** Whether the person of this page is logged in again. Asked once, however many requests wait for it. */
export function loggedIn(): Promise<boolean> {
  asking ??= ask().finally(() => (asking = null));
  return asking;
}

async function ask(): Promise<boolean> {
  return (await isBack()) || new LoginDialog().done;
}

/** Take over the token of the session as it is now. True if it is that of the page's own person. */
async function isBack(): Promise<boolean> {
  const session = await sessionNow();
  return session.person !== null && session.person === document.body.dataset.person;
}

async function sessionNow(): Promise<Session> {
  const response = await fetch(TOKEN, { headers: { Accept: "application/json" } });
  const session = (await response.json()) as Session;
  document.body.dataset.token = session.token;
  return session;
}

class LoginDialog {
  readonly done: Promise<boolean>;
  private readonly dialog = document.createElement("dialog");
  private readonly said = made("p", "", ENDED);
  private readonly label = made("label", "");
  private readonly words = made("span", "", "Password");
  private readonly input = document.createElement("input");
  private readonly go = made("button", "button main", "Log in") as HTMLButtonElement;
  private answer!: (back: boolean) => void;
  private place = LOGIN;

  constructor() {
    this.done = new Promise((answer) => (this.answer = answer));
    const { person = "" } = document.body.dataset;
    const form = document.createElement("form");
    const title = made("h2", "", `Log in again, ${person}`);
    title.id = "again-title";
    this.dialog.className = "again";
    this.dialog.setAttribute("aria-labelledby", title.id);
    this.said.setAttribute("role", "status");
    this.input.required = true;
    this.input.type = "password";
    this.input.autocomplete = "current-password";
    this.label.append(this.words, this.input);
    const other = made("a", "", "Log in in another tab") as HTMLAnchorElement;
    other.href = LOGIN;
    other.target = "_blank";
    const cancel = made("button", "button", "Not now") as HTMLButtonElement;
    cancel.type = "button";
    cancel.addEventListener("click", () => this.close(false));
    const acts = made("div", "acts");
    acts.append(this.go, cancel, other);
    form.append(title, this.said, this.label, acts);
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.send(person);
    });
    this.dialog.append(form);
    this.dialog.addEventListener("cancel", () => this.close(false));
    window.addEventListener("focus", this.look);
    document.body.append(this.dialog);
    this.dialog.showModal();
    this.input.focus();
  }

  /** Whether the person has logged in in another tab meanwhile. */
  private readonly look = (): void => {
    void isBack().then(
      (back) => back && this.close(true),
      () => undefined,
    );
  };

  private async send(person: string): Promise<void> {
    this.go.disabled = true;
    try {
      this.tell(await this.tried(person));
    } catch {
      this.tell("The server cannot be reached. Try again in a moment.");
    }
    this.go.disabled = false;
  }

  /** Log in, or give the second factor's code; the sentence of what is to be done next. Empty: nothing. */
  private async tried(person: string): Promise<string> {
    const before = await sessionNow();
    if (before.person === person) return this.close(true);
    if (before.person !== null) return `${before.person} is logged in in another tab. Log out there first.`;
    const fields: Record<string, string> =
      this.place === LOGIN ? { login: person, password: this.input.value } : { code: this.input.value };
    const response = await fetch(this.place, {
      method: "POST",
      headers: { Accept: "application/json", "X-CSRFToken": before.token },
      body: new URLSearchParams({ ...fields, next: TOKEN }),
    });
    const reply = (await response.json().catch(() => ({}))) as { location?: string; error?: string };
    if (await isBack()) return this.close(true);
    this.input.value = "";
    if (this.place === CODE && new URL(response.url).pathname === LOGIN) {
      this.askFor(LOGIN);
      return "Your second factor was reset. Enter your password.";
    }
    if (this.place === LOGIN && (reply.location ?? response.url).includes(CODE)) {
      this.askFor(CODE);
      return "Enter the code of your second factor.";
    }
    if (reply.error !== undefined) return reply.error;
    return this.place === LOGIN ? "Wrong password. Try again." : "Wrong code. Try again.";
  }

  private askFor(place: string): void {
    const code = place === CODE;
    this.place = place;
    this.words.textContent = code ? "Code of your authenticator" : "Password";
    Object.assign(
      this.input,
      code
        ? { type: "text", inputMode: "numeric", autocomplete: "one-time-code" }
        : { type: "password", inputMode: "text", autocomplete: "current-password" },
    );
  }

  private tell(text: string): void {
    this.said.textContent = text;
    this.input.focus();
  }

  private close(back: boolean): string {
    window.removeEventListener("focus", this.look);
    this.dialog.remove();
    this.answer(back);
    return "";
  }
}

function made(tag: string, kind: string, text = ""): HTMLElement {
  const element = document.createElement(tag);
  if (kind !== "") element.className = kind;
  element.textContent = text;
  return element;
}
