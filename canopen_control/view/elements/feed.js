export default {
  template: "<div style='display: none'></div>",
  methods: {
    dispatch(data) {
      for (const [key, detail] of Object.entries(data)) {
        window.dispatchEvent(new CustomEvent(`cc-${key}`, { detail }));
      }
      window.dispatchEvent(new CustomEvent("cc-pulse"));
    },
  },
};
