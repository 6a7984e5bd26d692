// Says again and again that this page is there, while it is `on`.
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
