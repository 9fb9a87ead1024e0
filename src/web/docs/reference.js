// The API reference: Scalar with /openapi.json, without anything that asks another host.

Scalar.createApiReference("#reference", {
  url: "../openapi.json",
  // Below the path at which a proxy publishes the service too; without a slash at the end, because
  // Scalar adds the paths to it.
  servers: [{ url: new URL("..", location.href).href.replace(/\/$/, "") }],
  withDefaultFonts: false,
  telemetry: false,
  agent: { disabled: true },
  defaultOpenAllTags: true,
  hideClientButton: true,
  showDeveloperTools: "never",
  defaultHttpClient: { targetKey: "shell", clientKey: "curl" },
});
