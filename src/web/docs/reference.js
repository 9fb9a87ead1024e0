// The API reference: Scalar with /openapi.json, without anything that asks another host.

Scalar.createApiReference("#reference", {
  url: "../openapi.json",
  withDefaultFonts: false,
  telemetry: false,
  agent: { disabled: true },
  defaultOpenAllTags: true,
  hideClientButton: true,
  showDeveloperTools: "never",
  defaultHttpClient: { targetKey: "shell", clientKey: "curl" },
});
