/* Hold to confirm: for what starts motion, or takes a machine away. */
const HOLD_MS = 1500;

/** Call `done` once the button was held for 1.5 s by finger, mouse, Enter or Space.
 *
 * `begin`, where it is given, is called as the hold begins.
 */
export function holdToConfirm(button, done, begin = () => {}) {
  let begun = null;
  let frame = 0;

  function step(now) {
    const share = Math.min(1, (now - begun) / HOLD_MS);
    button.style.setProperty("--hold-share", share);
    if (share < 1) {
      frame = requestAnimationFrame(step);
      return;
    }
    release();
    done();
  }

  function press() {
    if (begun !== null || button.disabled) return;
    begun = performance.now();
    begin();
    frame = requestAnimationFrame(step);
  }

  function release() {
    cancelAnimationFrame(frame);
    begun = null;
    button.style.setProperty("--hold-share", 0);
  }

  const isKey = (event) => event.key === "Enter" || event.key === " ";
  button.classList.add("hold");
  button.addEventListener("pointerdown", (event) => {
    if (event.button === 0) press();
  });
  for (const end of ["pointerup", "pointercancel", "pointerleave", "blur"]) {
    button.addEventListener(end, release);
  }
  button.addEventListener("keydown", (event) => {
    if (!isKey(event)) return;
    event.preventDefault();
    press();
  });
  button.addEventListener("keyup", release);
  button.addEventListener("contextmenu", (event) => event.preventDefault());
}
