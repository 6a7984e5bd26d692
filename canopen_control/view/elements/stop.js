// STOP is no part of the toolkit: it is there with the first lines of the page, and works before, without and after it.
(() => {
  const button = document.getElementById("cc-stop-button"), told = document.getElementById("cc-stop-told");
  const UNREACHED = "STOP has not reached the robot: the page's server does not answer. Use what else stops it.";
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
      const answer = await fetch("/stop", { method: "POST", cache: "no-store", keepalive: true, signal: AbortSignal.timeout(3000) });
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

  function judge() {
    const silent = performance.now() - heard > (begun ? SILENT_MS : LOADING_MS);
    document.documentElement.classList.toggle("cc-no-server", silent);
  }
  window.addEventListener("cc-pulse", () => {
    heard = performance.now();
    begun = true;
    judge();
  });
  window.addEventListener("cc-lost", (event) => document.documentElement.classList.toggle("cc-no-robot", event.detail));
  window.addEventListener("cc-latched", (event) => document.documentElement.classList.toggle("cc-is-latched", event.detail));
  setInterval(judge, 500);
})();
