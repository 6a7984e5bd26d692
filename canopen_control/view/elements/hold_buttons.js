// A pointer that leaves the button, a lost focus or a hidden page release the button. If the connection ends, the server
// releases it.
export default {
  template: `
    <div @contextmenu.prevent>
      <button v-for="button in buttons" :key="button.key" type="button" :class="['cc-held-' + button.key, { 'cc-down': down === button.key }]"
        :aria-label="button.label" @pointerdown="press($event, button.key)" @pointerup="leave(button.key)" @pointercancel="leave(button.key)"
        @lostpointercapture="leave(button.key)" @keydown="type($event, button.key)" @keyup.enter="leave(button.key)" @blur="leave(button.key)">
        <span class="cc-sign" aria-hidden="true">{{ button.sign }}</span><span>{{ button.label }}</span>
      </button>
    </div>`,
  props: { buttons: Array, period: Number },
  data: () => ({ down: null }),
  mounted() {
    this.all = () => this.release();
    this.keys = (event) => this.keyboard(event);
    window.addEventListener("blur", this.all);
    window.addEventListener("cc-stopped", this.all);
    document.addEventListener("visibilitychange", this.all);
    document.addEventListener("keydown", this.keys);
    document.addEventListener("keyup", this.keys);
  },
  beforeUnmount() {
    this.release();
    window.removeEventListener("blur", this.all);
    window.removeEventListener("cc-stopped", this.all);
    document.removeEventListener("visibilitychange", this.all);
    document.removeEventListener("keydown", this.keys);
    document.removeEventListener("keyup", this.keys);
  },
  methods: {
    press(event, key) {
      if (event.button !== 0) return;
      event.target.closest("button").setPointerCapture?.(event.pointerId);
      this.hold(key);
    },
    type(event, key) {
      if (event.key === "Enter" && !event.repeat) this.hold(key);
    },
    keyboard(event) {
      const match = this.buttons.find((button) => button.keyboard && button.keyboard === event.key);
      if (!match || event.target.closest("input, textarea, select, [role=slider]")) return;
      event.preventDefault();
      if (event.type === "keyup") this.leave(match.key);
      else if (!event.repeat) this.hold(match.key);
    },
    hold(key) {
      this.release();
      this.down = key;
      this.$emit("hold", key);
      this.timer = setInterval(() => this.$emit("hold", key), this.period);
    },
    leave(key) {
      // only for the held button: the previous button loses the focus after the next one was pressed
      if (this.down === key) this.release();
    },
    release() {
      if (this.down === null) return;
      clearInterval(this.timer);
      this.down = null;
      this.$emit("release");
    },
  },
};
