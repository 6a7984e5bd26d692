export default {
  template: "<div style='display: none'></div>",
  methods: {
    take(data) {
      for (const [key, detail] of Object.entries(data)) {
        window.dispatchEvent(new CustomEvent(`cc-${key}`, { detail }));
      }
      window.dispatchEvent(new CustomEvent("cc-pulse"));
    },
  },
};
