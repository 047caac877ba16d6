// Wherever a proxy shows the service: the addresses in its description begin at its root.
const root = location.pathname.replace(/\/docs\/?$/, "");
SwaggerUIBundle({
  url: `${root}/api/v1/openapi.json`,
  dom_id: "#docs",
  deepLinking: true,
  tryItOutEnabled: true,
  validatorUrl: null,
  requestInterceptor: (request) => {
    request.url = request.url.replace(`${location.origin}/api/`, `${location.origin}${root}/api/`);
    return request;
  },
});
