// Starts `dca lsp` for .dca files. Everything else is the server's.

const { commands, window, workspace } = require("vscode");
const { LanguageClient } = require("vscode-languageclient/node");

let client;

async function start() {
  const settings = workspace.getConfiguration("dca");
  const args = ["lsp", ...settings.get("controllers", []).flatMap((program) => ["--controllers", program])];
  const server = { command: settings.get("command", "dca"), args };
  client = new LanguageClient("dca", "DCA", server, { documentSelector: [{ language: "dca" }] });
  try {
    await client.start();
  } catch (error) {
    window.showErrorMessage(`DCA: cannot start \`${server.command} lsp\`: ${error.message ?? error}`);
  }
}

async function restart() {
  await stop();
  await start();
}

async function stop() {
  // A client that has not started has nothing to stop.
  await client?.stop().catch(() => undefined);
}

exports.activate = async (context) => {
  context.subscriptions.push(commands.registerCommand("dca.restart", restart));
  context.subscriptions.push(
    workspace.onDidChangeConfiguration((change) => {
      if (change.affectsConfiguration("dca")) restart();
    }),
  );
  await start();
};

exports.deactivate = stop;
