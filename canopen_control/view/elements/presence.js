// Reports periodically that this page is open, while `on` is true.
export default {
  template: "<div style='display: none'></div>",
  props: { on: Boolean, period: Number },
  mounted() {
    this.timer = setInterval(() => this.on && this.$emit("here"), this.period);
  },
  beforeUnmount() {
    clearInterval(this.timer);
  },
};
