/* One state, replaced by patches; listeners hear once a frame. */

/** Make a store: `get()`, `set(patch)`, `listen(listener) -> forget`. */
export function createStore(initial) {
  let state = initial;
  let scheduled = false;
  const listeners = new Set();

  function tell() {
    scheduled = false;
    for (const listener of [...listeners]) listener(state);
  }

  return {
    get: () => state,
    set(patch) {
      state = { ...state, ...patch };
      if (scheduled) return;
      scheduled = true;
      // Frames stop in a hidden tab; a timer behind them keeps the state moving there.
      let told = false;
      const once = () => {
        if (!told) tell();
        told = true;
      };
      requestAnimationFrame(once);
      setTimeout(once, 250);
    },
    listen(listener) {
      listeners.add(listener);
      return () => listeners.delete(listener);
    },
  };
}
