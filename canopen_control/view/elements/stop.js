// STOP does not use NiceGUI: the button works before NiceGUI is loaded, and when NiceGUI fails.
(() => {
  const button = document.getElementById("cc-stop-button"), message = document.getElementById("cc-stop-message");
  const nextStep = document.getElementById("cc-dead-next");
  const UNREACHED = "STOP has not reached the robot: the page's server does not answer. Use another way to stop the robot (emergency stop, terminal).";
  const OLD_ADDRESS = "The view was restarted with another address: open the address that it has printed (canopen-control view --address prints it again).";
  const SILENT_MS = 2500, LOADING_MS = 15000, MESSAGE_MS = 8000;
  let lastPulse = performance.now(), isLoaded = false, clearTimer = 0;

  function show(text, bad) {
    message.textContent = text;
    message.classList.toggle("cc-bad", bad);
    clearTimeout(clearTimer);
    if (!bad) clearTimer = setTimeout(() => (message.textContent = ""), MESSAGE_MS);
  }

  async function stop() {
    window.dispatchEvent(new CustomEvent("cc-stopped"));
    try {
      const response = await fetch("stop", { method: "POST", cache: "no-store", keepalive: true, signal: AbortSignal.timeout(3000) });
      const text = await response.text();
      show(response.ok ? text : `STOP has not reached the robot. ${text}`, !response.ok);
    } catch {
      show(UNREACHED, true);
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

  let isSilent = false;
  function updateSilence() {
    isSilent = performance.now() - lastPulse > (isLoaded ? SILENT_MS : LOADING_MS);
    document.documentElement.classList.toggle("cc-no-server", isSilent);
  }

  async function checkServer() {
    if (!isSilent) return;
    try {
      const response = await fetch("stop", { method: "HEAD", cache: "no-store", signal: AbortSignal.timeout(2000) });
      if (response.status === 403) nextStep.textContent = OLD_ADDRESS;
    } catch {} // no answer: the server may come back
  }
  window.addEventListener("cc-pulse", () => {
    lastPulse = performance.now();
    isLoaded = true;
    updateSilence();
  });
  window.addEventListener("cc-lost", (event) => document.documentElement.classList.toggle("cc-no-robot", event.detail));
  window.addEventListener("cc-latched", (event) => document.documentElement.classList.toggle("cc-is-latched", event.detail));
  setInterval(updateSilence, 500);
  setInterval(checkServer, 2000);
})();
