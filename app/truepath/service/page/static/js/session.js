/* Who works at this page: log in, the name in the bar, what the role may do. */
import * as api from "./api.js";
import { h, write } from "./dom.js";
import { lineOf } from "./problems.js";
import { t } from "./texts.js";

const WAIT_MS = 500;

/** Return once somebody may use the page: at once where nobody has to log in. */
export async function enter(root) {
  let session = await ask();
  if (session?.log_in_required && !session.name) session = await logIn(root);
  if (!session?.log_in_required) return;
  document.body.dataset.role = session.role;
  const user = document.getElementById("user");
  write(user, `${session.name} · ${t(`session.${session.role}`)}`);
  user.hidden = false;
}

/** Whether somebody is logged in, who can be logged out. */
export const isLoggedIn = () => Boolean(document.body.dataset.role);

export async function logOut() {
  await api.logOut();
  location.reload();
}

/** Ask for a log-in again, but never over an abort that is under way. */
export function leave() {
  if (document.getElementById("abort-sheet").hidden) location.reload();
  else setTimeout(leave, WAIT_MS);
}

/** Leave if the session has ended. */
export async function check() {
  const session = await ask();
  if (session?.log_in_required && !session.name) leave();
}

/** Null while the service does not answer: the page says so by itself. */
async function ask() {
  try {
    return await api.session();
  } catch (error) {
    api.expectProblem(error);
    return null;
  }
}

function logIn(root) {
  const name = h("input", { id: "user-name", name: "username", autocomplete: "username", autocapitalize: "none",
    required: true, maxlength: 64 });
  const password = h("input", { id: "user-password", name: "password", type: "password",
    autocomplete: "current-password", required: true, maxlength: 200 });
  const error = h("p", { class: "field-error", role: "alert" });
  const button = h("button", { class: "next", type: "submit" }, t("session.log_in"));
  const form = h("form", { class: "card log-in" }, h("h1", {}, t("session.log_in")),
    h("div", { class: "field" }, h("label", { for: "user-name" }, t("session.name")), name),
    h("div", { class: "field" }, h("label", { for: "user-password" }, t("session.password")), password),
    error, button, h("p", { class: "quiet" }, t("session.abort_works")));
  document.body.classList.add("is-closed");
  root.replaceChildren(form);
  name.focus();
  return new Promise((done) => {
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      button.disabled = true;
      try {
        const session = await api.logIn(name.value, password.value);
        root.replaceChildren();
        document.body.classList.remove("is-closed");
        done(session);
      } catch (problem) {
        if (!(problem instanceof api.Problem)) throw problem;
        error.replaceChildren(...worded(problem));
        password.value = "";
        password.focus();
      } finally {
        button.disabled = false;
      }
    });
  });
}

function worded(problem) {
  const { status } = problem;
  if (status === 0) return [t("problem.unreachable")];
  if (status === 429) return [t("session.wait")];
  return status === 401 ? [t("session.wrong")] : lineOf(problem);
}
