const HEIGHT = 84, LEFT = 44, BOTTOM = 18, TOP = 6, RIGHT = 8;

function nice(span, count) {
  const raw = span / Math.max(count, 1), power = 10 ** Math.floor(Math.log10(raw || 1));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= raw) || power * 10;
}

export default {
  template: `
    <div>
      <figure v-for="chart in charts" :key="chart.key">
        <figcaption><b>{{ titles[chart.key] || chart.title }}</b>
          <span v-for="line in chart.lines" class="cc-legend"><i :style="{ background: line.color }"></i>{{ line.name }}
            <em :ref="'v-' + line.row"></em></span>
        </figcaption>
        <canvas :ref="'c-' + chart.key" @pointermove="point($event)" @pointerleave="pointAt = null; draw()"></canvas>
      </figure>
    </div>`,
  props: { charts: Array, names: Array, span: Number },
  data: () => ({ titles: {} }),
  created() {
    this.rows = [];
    this.pointAt = null;
    this.plain = JSON.parse(JSON.stringify(this.charts)); // a plain copy, which Vue does not observe
    for (const chart of this.plain) chart.columns = chart.lines.map((line) => this.names.indexOf(line.row) + 1);
  },
  mounted() {
    this.onPlots = (event) => this.addRows(event.detail);
    this.onTitles = (event) => (this.titles = event.detail);
    window.addEventListener("cc-plots", this.onPlots);
    window.addEventListener("cc-titles", this.onTitles);
    this.resizeObserver = new ResizeObserver(() => this.draw());
    this.resizeObserver.observe(this.$el);
  },
  beforeUnmount() {
    window.removeEventListener("cc-plots", this.onPlots);
    window.removeEventListener("cc-titles", this.onTitles);
    this.resizeObserver.disconnect();
  },
  methods: {
    addRows(news) {
      if (news.replace) this.rows = [];
      for (const row of news.rows) {
        if (this.rows.length && row[0] < this.rows[this.rows.length - 1][0]) this.rows = [];
        this.rows.push(row);
      }
      const newest = this.rows.length ? this.rows[this.rows.length - 1][0] : 0;
      let outdated = 0;
      while (outdated < this.rows.length && this.rows[outdated][0] < newest - this.span) outdated += 1;
      if (outdated) this.rows.splice(0, outdated);
      if (!this.pending) {
        this.pending = true;
        requestAnimationFrame(() => {
          this.pending = false;
          this.draw();
        });
      }
    },
    point(event) {
      const box = event.target.getBoundingClientRect();
      this.pointAt = Math.min(1, Math.max(0, (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT)));
      this.draw();
    },
    draw() {
      for (const chart of this.plain) {
        const canvas = this.$refs["c-" + chart.key]?.[0];
        if (canvas && canvas.offsetParent !== null) this.drawOne(chart, canvas);
      }
    },
    drawOne(chart, canvas) {
      const ratio = Math.min(window.devicePixelRatio || 1, 2), width = canvas.clientWidth;
      if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(HEIGHT * ratio)) {
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(HEIGHT * ratio);
      }
      const g = canvas.getContext("2d");
      g.setTransform(ratio, 0, 0, ratio, 0, 0);
      g.clearRect(0, 0, width, HEIGHT);
      const columns = chart.columns;
      const [low, high] = this.range(chart, columns);
      const newest = this.rows.length ? this.rows[this.rows.length - 1][0] : 0;
      const x = (time) => LEFT + (1 - (newest - time) / this.span) * (width - LEFT - RIGHT);
      const y = (value) => TOP + ((high - value) / (high - low)) * (HEIGHT - TOP - BOTTOM);
      this.grid(g, width, low, high, y);
      chart.lines.forEach((line, number) => this.line(g, columns[number], line.color, x, y));
      this.readings(g, chart, columns, newest, x);
    },
    range(chart, columns) {
      let low = chart.low, high = chart.high;
      for (const row of this.rows) {
        for (const column of columns) {
          if (row[column] === null) continue;
          low = Math.min(low, row[column]);
          high = Math.max(high, row[column]);
        }
      }
      const pad = (high - low) * 0.08;
      return [chart.low === 0 && low === 0 ? 0 : low - pad, high + pad];
    },
    grid(g, width, low, high, y) {
      g.font = "11px Roboto, sans-serif";
      g.fillStyle = "#5b6673";
      g.strokeStyle = "#e3e7ec";
      g.lineWidth = 1;
      g.textAlign = "right";
      g.textBaseline = "middle";
      const step = nice(high - low, 4);
      for (let value = Math.ceil(low / step) * step; value <= high; value += step) {
        const at = Math.round(y(value)) + 0.5;
        g.beginPath();
        g.moveTo(LEFT, at);
        g.lineTo(width - RIGHT, at);
        g.stroke();
        g.fillText(String(+value.toPrecision(6)), LEFT - 5, at);
      }
      g.textBaseline = "alphabetic";
      for (let seconds = -this.span; seconds <= 0; seconds += 10) {
        g.textAlign = seconds === 0 ? "right" : "center";
        g.fillText(seconds === 0 ? "now" : `${seconds} s`, LEFT + (1 + seconds / this.span) * (width - LEFT - RIGHT), HEIGHT - 4);
      }
    },
    line(g, column, color, x, y) {
      g.strokeStyle = color;
      g.lineWidth = 1.8;
      g.lineJoin = "round";
      g.beginPath();
      let before = null;
      for (const row of this.rows) {
        const value = row[column];
        if (value === null) {
          before = null;
          continue;
        }
        if (before !== null && row[0] - before < 0.5) g.lineTo(x(row[0]), y(value));
        else g.moveTo(x(row[0]), y(value));
        before = row[0];
      }
      g.stroke();
    },
    readings(g, chart, columns, newest, x) {
      let row = null;
      if (this.pointAt !== null) {
        const time = newest - (1 - this.pointAt) * this.span;
        row = this.rows.reduce((best, candidate) => (best === null || Math.abs(candidate[0] - time) < Math.abs(best[0] - time) ? candidate : best), null);
        if (row) {
          g.fillStyle = "#16324f";
          g.fillRect(Math.round(x(row[0])), TOP, 1, HEIGHT - TOP - BOTTOM);
        }
      }
      chart.lines.forEach((line, number) => {
        const label = this.$refs["v-" + line.row]?.[0];
        const value = row?.[columns[number]];
        if (label) label.textContent = value === null || value === undefined ? "" : value.toFixed(3);
      });
    },
  },
};
