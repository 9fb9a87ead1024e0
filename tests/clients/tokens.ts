// Session tokens by jose, without a request to the server: it accepts them, and refuses what jose
// makes otherwise.
//
//     node compiled/tokens.js SERVER KEY SECRET

import { strict as assert } from "node:assert";
import { createHash, createHmac, randomUUID } from "node:crypto";

import { SignJWT, jwtVerify } from "jose";

const [server, key, secret] = process.argv.slice(2) as [string, string, string];
const bytes = new TextEncoder().encode(secret);
const HEADER = { alg: "HS256", kid: "k1", typ: "mlswarp+jwt" };

/** The claims, as deploy/README.md describes them. */
function claims(session: string) {
  const owner = createHash("sha256").update("mlswarp owner\0ann").digest().subarray(0, 16);
  const digest = createHash("sha256").update(key).digest();
  const mark = createHmac("sha256", secret).update("mlswarp key\0").update(digest).digest();
  return {
    own: owner.toString("base64url"),
    key: mark.subarray(0, 8).toString("base64url"),
    sid: session,
    ops: ["read"],
  };
}

const token = (session: string, header = HEADER, expires = "10m") =>
  new SignJWT(claims(session))
    .setProtectedHeader(header)
    .setAudience("mlswarp")
    .setIssuedAt()
    .setExpirationTime(expires)
    .setJti(randomUUID())
    .sign(bytes);

/** The status and the code: 404 says that the token was accepted, before the session was. */
async function read(session: string, bearer: string) {
  const headers = { Authorization: `Bearer ${bearer}` };
  const answer = await fetch(`${server}/sessions/${session}`, { headers });
  return [answer.status, ((await answer.json()) as { code: string }).code];
}

const session = randomUUID();
assert.deepEqual(await read(session, await token(session)), [404, "no_such_session"]);
assert.deepEqual(await read(randomUUID(), await token(session)), [403, "forbidden"]);
for (const wrong of [
  await token(session, { ...HEADER, alg: "HS384" }),
  await token(session, { ...HEADER, typ: "JWT" }),
  await token(session, { alg: "HS256", typ: "mlswarp+jwt", kid: "k1" }),
  await token(session, HEADER, "2h"),
])
  assert.deepEqual(await read(session, wrong), [401, "unauthorized"]);
// And what the server makes, jose reads.
const minted = await fetch(`${server}/sessions/${session}/tokens`, {
  method: "POST",
  headers: { Authorization: `Bearer ${key}`, "Content-Type": "application/json" },
  body: JSON.stringify({ ops: ["upload"] }),
});
const { token: made } = (await minted.json()) as { token: string };
const { payload } = await jwtVerify(made, bytes, { audience: "mlswarp", typ: "mlswarp+jwt" });
assert.equal(payload["own"], claims(session).own);
assert.equal(payload["key"], claims(session).key);
console.log("tokens: jose and the server read each other's");
