/**
 * A plan from TypeScript, with Zenoh's own client and nothing of guidefield.
 *
 *     npm install && npm run build
 *     npm start -- ws/127.0.0.1:10000
 *
 * Browsers and Node have no TCP link of Zenoh's: this client talks to a router with the plugin `remote-api`, over a
 * WebSocket, and the router to the service (`guidefield serve --config` with the router in `connect/endpoints`).
 *
 * What a client in any language does is told in `tools/examples/plain_zenoh.py`; the messages are in
 * `guidefield docs wire`.
 */

import { randomUUID } from "node:crypto";
import { argv, exit } from "node:process";

import { Config, Encoding, ReplyError, Sample, Session } from "@eclipse-zenoh/zenoh-ts";
import { Duration } from "typed-duration";

interface Status {
  code: number;
  name: string;
  message: string;
}

interface PlanReply {
  status: Status;
  position_names: string[];
  trajectory: { times: number[]; positions: number[][]; velocities: number[][] } | null;
  clearance: { minimum: number | null; pair: [string, string] | null } | null;
}

const PLANNING_TIME = 60;
/** The query has more time than the plan, so that the service has the last word [s]. */
const MARGIN = 90;

/** The payload of the one answer; an error where it is one, or where there is none. */
async function ask(session: Session, key: string, request: unknown, seconds: number): Promise<string> {
  const answers = await session.get(key, {
    payload: JSON.stringify(request),
    encoding: Encoding.APPLICATION_JSON,
    attachment: "plan.ts",
    timeout: Duration.seconds.of(seconds),
  });
  for await (const answer of answers ?? []) {
    const result = answer.result();
    if (result instanceof Sample) {
      return result.payload().toString();
    }
    throw new Error(told(result));
  }
  throw new Error("the service is gone");
}

/** What an error says: guidefield's are JSON, Zenoh's own are words. */
function told(error: ReplyError): string {
  const words = error.payload().toString();
  if (!words.startsWith("{")) {
    return words;
  }
  const { name, code, message } = JSON.parse(words) as Status;
  return `${name} (${code}): ${message}`;
}

/** A service, found by its liveliness token; the prefix of its keys. */
async function found(session: Session): Promise<string> {
  const tokens = await session.liveliness().get("guidefield/*/alive", { timeout: Duration.seconds.of(5) });
  for await (const token of tokens ?? []) {
    const result = token.result();
    if (result instanceof Sample) {
      return result.keyexpr().toString().replace(/\/alive$/, "");
    }
  }
  throw new Error("no service is alive");
}

/** Positions at a time: the cubic Hermite curve through the knots, which is what was certified. */
function at(trajectory: NonNullable<PlanReply["trajectory"]>, time: number): number[] {
  const { times, positions, velocities } = trajectory;
  const next = times.findIndex((knot, index) => index > 0 && knot >= time);
  const i = (next < 0 ? times.length - 1 : next) - 1;
  const h = times[i + 1]! - times[i]!;
  const s = (time - times[i]!) / h;
  const [a, b, c, d] = [2 * s ** 3 - 3 * s ** 2 + 1, s ** 3 - 2 * s ** 2 + s, 3 * s ** 2 - 2 * s ** 3, s ** 3 - s ** 2];
  return positions[i]!.map(
    (p, j) => a * p + b * h * velocities[i]![j]! + c * positions[i + 1]![j]! + d * h * velocities[i + 1]![j]!,
  );
}

async function main(): Promise<void> {
  const session = await Session.open(new Config(argv[2] ?? "ws/127.0.0.1:10000", 5000));
  try {
    const service = await found(session);
    const run_id = randomUUID();
    const watched = await session.declareSubscriber(`${service}/runs/${run_id}/progress`, {
      handler: (sample: Sample) => {
        const progress = JSON.parse(sample.payload().toString()) as { elapsed: number; stage: string };
        console.log(`${progress.elapsed.toFixed(2)} s: ${progress.stage}`);
      },
    });
    const request = {
      run_id,
      robot: "ur5",
      scene: "table",
      goal: { type: "joints", positions: { elbow_joint: 1.2 } },
      guide_planes: [],
      allowed_planning_time: PLANNING_TIME,
    };
    const reply = JSON.parse(
      await ask(session, `${service}/plan`, request, PLANNING_TIME + MARGIN),
    ) as PlanReply;
    await watched.undeclare();
    console.log(`${reply.status.name}: ${reply.status.message}`);
    if (reply.trajectory === null) {
      exit(1);
    }
    const end = reply.trajectory.times.at(-1)!;
    const elbow = reply.position_names.indexOf("elbow_joint");
    console.log(`${end.toFixed(3)} s long; the elbow is at ${at(reply.trajectory, end)[elbow]!.toFixed(6)} then`);
    if (reply.clearance?.minimum != null) {
      const between = reply.clearance.pair?.join(" and ") ?? "nothing";
      console.log(`${(1e3 * reply.clearance.minimum).toFixed(1)} mm between ${between}`);
    }
    await ask(session, `${service}/plan`, { robot: "ur6" }, MARGIN).catch((error: Error) =>
      console.log(`refused, as it should be: ${error.message}`),
    );
  } finally {
    await session.close();
  }
}

main().then(
  () => exit(0),
  (error: Error) => {
    console.error(error.message);
    exit(2);
  },
);
