// Looks at a mission with Foxglove's own client: 20 topics of three types, a parameter and a service.
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const WebSocket = require("ws");

const client = new FoxgloveClient({ ws: new WebSocket(process.argv[2], ["foxglove.sdk.v1"]) });
const fail = (why) => { console.error(why); process.exit(1); };
setTimeout(() => fail("not done in 60 s"), 60000).unref();
client.on("error", fail);
client.on("close", () => fail("the connection was closed"));

const topics = new Map(), types = new Map(), seen = new Map(), limit = "door:main/guard.limit";
const wanted = (topic) => /^\/(ports|signals)\/main\/m?beat/.test(topic) || topic === "/mission" || topic === "/events";
let services = new Map(), isAsked = false;

client.on("advertise", (channels) => channels.forEach((channel) => {
  const schema = JSON.parse(channel.schema);
  if (!wanted(channel.topic)) return;
  const id = client.subscribe(channel.id);
  topics.set(id, channel.topic);
  types.set(channel.topic, [channel.schemaName, Object.keys(schema.properties)]);
}));
client.on("advertiseServices", (all) => { all.forEach((one) => services.set(one.name, one)); next(); });
client.on("message", ({ subscriptionId, data }) => {
  const topic = topics.get(subscriptionId), [name, fields] = types.get(topic);
  const value = JSON.parse(new TextDecoder().decode(data));
  if (!Object.keys(value).every((field) => fields.includes(field))) fail(`${topic}: ${JSON.stringify(value)}`);
  seen.set(topic, name);
  next();
});

function next() {
  const names = new Set(seen.values());
  if (isAsked || seen.size < 20 || names.size < 3 || !services.has("/calls/main/wheels/Drive")) return;
  isAsked = true;
  console.log(`${seen.size} topics of ${[...names].sort()}`);
  client.on("parameterValues", ({ parameters, id }) => {
    if (id === "read" && parameters[0].value === 0.5) client.setParameters([{ name: limit, value: 0.25 }], "set");
    else if (id === "set" && parameters[0].value === 0.25) call();
    else if (id) fail(JSON.stringify(parameters));
  });
  client.getParameters([limit], "read");
}

function call() {
  const { id } = services.get("/calls/main/wheels/Drive");
  client.on("serviceCallFailure", (failure) => fail(JSON.stringify(failure)));
  client.on("serviceCallResponse", (response) => {
    const result = JSON.parse(new TextDecoder().decode(response.data));
    if (response.callId !== 7 || result.speed !== 0.25) fail(JSON.stringify(result));
    console.log("done");
    process.exit(0);
  });
  const data = new TextEncoder().encode(JSON.stringify({ speed: 0.25 }));
  client.sendServiceCallRequest({ serviceId: id, callId: 7, encoding: "json", data: new DataView(data.buffer) });
}
