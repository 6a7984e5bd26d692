// The object dictionary as a tree of groups, objects and subindices. The server reads only the objects that this element
// reports as visible. The browser stores the favourites by product, so that all drives of a type have the same ones.
const GROUPS = [
  ["Communication", 0x1000, 0x1fff],
  ["Manufacturer-specific", 0x2000, 0x5fff],
  ["Device profile", 0x6000, 0x9fff],
  ["Others", 0, 0xffff],
];

const Row = {
  template: `
    <div :class="['cc-o', { 'cc-o-sub': row.sub, 'cc-o-changed': live.changed, 'cc-o-open': open }]" :data-a="row.a">
      <button type="button" class="cc-o-star" :aria-pressed="star" :aria-label="'favourite ' + row.a" @click="$emit('star')">{{ star ? "★" : "☆" }}</button>
      <button type="button" class="cc-o-name" :aria-expanded="open" @click="$emit('toggle')"><code>{{ row.a }}</code><span>{{ row.name }}</span></button>
      <span class="cc-o-value" :title="live.error || ''"><i v-if="live.changed" title="not the default">●</i><b>{{ live.value ?? (live.error ? "refused" : "–") }}</b><small v-if="row.unit && live.value != null">{{ row.unit }}</small>
        <em v-if="live.meaning">{{ live.meaning }}</em></span>
      <span class="cc-o-default">{{ row.default ?? "" }}</span><span class="cc-o-type">{{ row.type }} · {{ row.access }}</span>
      <div v-if="open" class="cc-o-more">
        <p class="cc-note">{{ row.type }}, {{ row.access }}<template v-if="row.mappable">, PDO {{ row.mappable }}</template><template v-if="row.limits">; {{ row.limits }} {{ row.unit }}</template><template v-if="row.default != null">; default {{ row.default }}</template></p>
        <p v-if="live.error" class="cc-line cc-bad">{{ live.error }}</p>
        <div v-if="bits && bits.length" class="cc-bits"><span v-for="element in bits" :key="element[0]" :class="{ 'cc-set': element[2] }">{{ element[0] }} {{ element[1] }}</span></div>
        <p v-if="row.fixed" class="cc-note">Cannot be written here: the object {{ row.fixed }}.</p>
        <p v-else-if="!writes" class="cc-note">This page is read-only. To write, start <code>canopen-control view --teleop</code></p>
        <form v-else class="cc-o-edit cc-acts" @submit.prevent="$emit('write', text)">
          <input v-model="text" :aria-label="'new value of ' + row.a" :placeholder="live.value ?? ''" autocomplete="off" spellcheck="false">
          <button type="submit" class="cc-button">Write</button>
          <button v-if="row.default != null" type="button" class="cc-button cc-plain" @click="text = row.default">Default</button>
        </form>
        <p v-if="result" :class="['cc-line', result.good ? 'cc-good' : 'cc-bad']" role="status">{{ result.text }}</p>
      </div>
    </div>`,
  props: { row: Object, live: Object, star: Boolean, open: Boolean, bits: Array, result: Object, writes: Boolean },
  emits: ["star", "toggle", "write"],
  data: () => ({ text: "" }),
};

export default {
  components: { Row },
  template: `
    <div class="cc-objects">
      <div class="cc-o-bar">
        <input v-model="search" type="search" maxlength="200" aria-label="search objects" placeholder="Search: 0x6081, 0x60*, velocity" @input="ask" autocomplete="off" spellcheck="false">
        <button v-for="[key, words] in filters" :key="key" type="button" :class="['cc-filter', { 'cc-on-now': filter === key }]" :aria-pressed="filter === key" @click="filter = key">{{ words }}</button>
        <span class="cc-note">{{ shown.size }} of {{ rows.length }}</span>
      </div>
      <p v-if="problem" class="cc-line cc-warn">{{ problem }}</p>
      <div v-if="shown.size" class="cc-o cc-o-head"><span></span><span>object</span><span>value</span><span>default</span><span>type · access</span></div>
      <section v-for="group in groups" :key="group.title">
        <button type="button" class="cc-o-group" :aria-expanded="!closed[group.title]" @click="closed[group.title] = !closed[group.title]">{{ closed[group.title] ? "▸" : "▾" }} {{ group.title }}<small>{{ group.count }}</small></button>
        <template v-if="!closed[group.title]">
          <template v-for="object in group.objects" :key="object.index">
            <button v-if="object.name" type="button" class="cc-o-record" :aria-expanded="isWide(object)" @click="wide[object.index] = !isWide(object)">
              <span>{{ isWide(object) ? "▾" : "▸" }}</span><code>{{ object.place }}</code><span>{{ object.name }}</span><small>{{ object.rows.length }}</small><i v-if="object.rows.some((element) => live[element.a]?.changed)">●</i></button>
            <template v-if="!object.name || isWide(object)">
              <Row v-for="row in object.rows" :key="row.a" :row="row" :live="live[row.a] || none" :star="!!stars[row.a]" :open="!!opened[row.a]" :bits="opened[row.a] ? live[row.a]?.bits : null"
                :result="results[row.a]" :writes="writes" @star="toggleFavourite(row.a)" @toggle="toggle(row.a)" @write="(text) => $emit('write', { address: row.a, text })" />
            </template>
          </template>
        </template>
      </section>
      <p v-if="!shown.size && !problem" class="cc-note">{{ filter === "star" ? "No favourites yet: press the star of an object." : filter === "changed" ? "No object that was read differs from its default. Only visible objects are read." : "No objects." }}</p>
    </div>`,
  props: { rows: Array, writes: Boolean, product: String },
  data: () => ({ search: "", filter: "all", hits: null, problem: "", live: {}, stars: {}, opened: {}, results: {}, wide: {}, closed: {}, none: {} }),
  computed: {
    filters: () => [["all", "All"], ["star", "★ Favourites"], ["changed", "● Changed"]],
    shown() {
      const passes = (row) => (!this.hits || this.hits.has(row.a)) && (this.filter === "all" || (this.filter === "star" ? this.stars[row.a] : this.live[row.a]?.changed));
      return new Set(this.rows.filter(passes).map((row) => row.a));
    },
    groups() {
      const groups = GROUPS.map(([title]) => ({ title, objects: [], count: 0 }));
      let last = null;
      for (const row of this.rows) {
        if (!this.shown.has(row.a)) continue;
        const group = groups[GROUPS.findIndex(([, first, end]) => row.index >= first && row.index <= end)];
        if (!last || last.index !== row.index) {
          last = { index: row.index, place: row.a.slice(0, 6), name: row.object, rows: [] };
          group.objects.push(last);
        }
        last.rows.push(row);
        group.count += 1;
      }
      return groups.filter((group) => group.count);
    },
  },
  mounted() {
    this.key = `cc-favourites-${this.product}`;
    try {
      this.stars = JSON.parse(localStorage.getItem(this.key)) || {};
    } catch {
      this.stars = {};
    }
    this.seen = new Set();
    this.isConnected = false;
    this.answered = "";
    this.watcher = new IntersectionObserver((entries) => {
      for (const element of entries) {
        if (element.isIntersecting) this.seen.add(element.target.dataset.a);
        else this.seen.delete(element.target.dataset.a);
      }
      this.reportVisible();
    });
    this.observe();
    // events sent before the connection is open are lost, so the visible objects are reported until the server answers
    this.retryTimer = setInterval(() => {
      if (!this.isConnected) {
        this.reported = null;
        this.reportVisible();
      }
      if (this.search !== this.answered) this.sendSearch();
    }, 1000);
  },
  updated() {
    this.observe();
  },
  beforeUnmount() {
    this.watcher.disconnect();
    clearTimeout(this.reportTimer);
    clearInterval(this.retryTimer);
  },
  methods: {
    observe() {
      const elements = new Set(this.$el.querySelectorAll("[data-a]"));
      for (const element of this.watched || []) {
        if (elements.has(element)) continue;
        this.watcher.unobserve(element);
        this.seen.delete(element.dataset.a);
      }
      for (const element of elements) if (!this.watched?.has(element)) this.watcher.observe(element);
      this.watched = elements;
      this.reportVisible();
    },
    reportVisible() {
      clearTimeout(this.reportTimer);
      this.reportTimer = setTimeout(() => {
        const addresses = [...this.seen].sort();
        const now = addresses.join();
        if (now === this.reported) return;
        this.reported = now;
        this.$emit("seen", addresses);
      }, 150);
    },
    sendSearch() {
      clearTimeout(this.searchTimer);
      this.searchTimer = setTimeout(() => this.$emit("search", this.search), 200);
    },
    isWide(object) {
      return this.wide[object.index] ?? (!!this.hits || this.filter !== "all");
    },
    toggleFavourite(address) {
      if (this.stars[address]) delete this.stars[address];
      else this.stars[address] = true;
      try {
        localStorage.setItem(this.key, JSON.stringify(this.stars));
      } catch {
        // without storage the favourites last until the page is closed
      }
    },
    toggle(address) {
      this.opened[address] = !this.opened[address];
      delete this.results[address];
    },
    // methods called by the server
    values(news) {
      this.isConnected = true;
      Object.assign(this.live, news);
    },
    matches(addresses, problem, text) {
      this.answered = text;
      this.hits = addresses && new Set(addresses);
      this.problem = problem;
    },
    answer(address, text, good) {
      this.results[address] = { text, good };
    },
  },
};
