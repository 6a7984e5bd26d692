// STOP does not use NiceGUI: the button works before NiceGUI is loaded, and when NiceGUI fails.
(() => {
  const button = document.getElementById("cc-stop-button"), told = document.getElementById("cc-stop-told");
  const dead = document.getElementById("cc-dead-next");
  const UNREACHED = "STOP has not reached the robot: the page's server does not answer. Use another way to stop the robot (emergency stop, terminal).";
  const OLD_ADDRESS = "The view was restarted with another address: open the address that it has printed (canopen-control view --address prints it again).";
  const SILENT_MS = 2500, LOADING_MS = 15000, TOLD_MS = 8000;
  let heard = performance.now(), begun = false, telling = 0;

  function tell(text, bad) {
    told.textContent = text;
    told.classList.toggle("cc-bad", bad);
    clearTimeout(telling);
    if (!bad) telling = setTimeout(() => (told.textContent = ""), TOLD_MS);
  }

  async function stop() {
    window.dispatchEvent(new CustomEvent("cc-stopped"));
    try {
      const answer = await fetch("stop", { method: "POST", cache: "no-store", keepalive: true, signal: AbortSignal.timeout(3000) });
      const text = await answer.text();
      tell(answer.ok ? text : `STOP has not reached the robot. ${text}`, !answer.ok);
    } catch {
      tell(UNREACHED, true);
    }
  }

  button.addEventListener("pointerdown", (event) => event.button === 0 && stop());
  button.addEventListener("click", (event) => event.detail === 0 && stop()); // by the keyboard, or a screen reader
  document.addEventListener("keydown", (event) => {
    if (event.code !== "Space" || event.target.closest?.("input:not([type=range]), textarea, [contenteditable]")) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (!event.repeat) stop();
  }, true);
  document.addEventListener("keyup", (event) => event.code === "Space" && event.target === button && event.preventDefault(), true);

  let silent = false;
  function judge() {
    silent = performance.now() - heard > (begun ? SILENT_MS : LOADING_MS);
    document.documentElement.classList.toggle("cc-no-server", silent);
  }

  async function ask() {
    if (!silent) return;
    try {
      const answer = await fetch("stop", { method: "HEAD", cache: "no-store", signal: AbortSignal.timeout(2000) });
      if (answer.status === 403) dead.textContent = OLD_ADDRESS;
    } catch {} // no answer: the server may come back
  }
  window.addEventListener("cc-pulse", () => {
    heard = performance.now();
    begun = true;
    judge();
  });
  window.addEventListener("cc-lost", (event) => document.documentElement.classList.toggle("cc-no-robot", event.detail));
  window.addEventListener("cc-latched", (event) => document.documentElement.classList.toggle("cc-is-latched", event.detail));
  setInterval(judge, 500);
  setInterval(ask, 2000);
})();
