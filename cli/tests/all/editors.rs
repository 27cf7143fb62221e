//! The configurations in `editors/README.md` are correct: tried with the Neovim that is installed.

use std::path::{Path, PathBuf};
use std::process::Command;

const README: &str = include_str!("../../../editors/README.md");

/// The block of a language after a line of the page.
fn block(after: &str, language: &str) -> &'static str {
    let (_, rest) = README.split_once(after).expect("the page has the line");
    let (_, rest) = rest.split_once(&format!("```{language}\n")).expect("a block follows");
    rest.split_once("\n```").expect("the block ends").0
}

/// The version of the Neovim here: 7 for 0.7.2.
fn neovim() -> Option<u32> {
    let told = Command::new("nvim").arg("--version").output().ok()?;
    let text = String::from_utf8_lossy(&told.stdout).into_owned();
    text.lines().next()?.split('.').nth(1)?.parse().ok()
}

#[test]
fn neovim_shows_what_is_wrong() {
    let Some(version) = neovim() else {
        println!("skipped: needs nvim");
        return;
    };
    let folder = std::env::temp_dir().join(format!("dca-nvim-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let after = if version >= 11 { "0.11 or newer" } else { "Older, from 0.7" };
    std::fs::write(folder.join("init.lua"), block(after, "lua")).unwrap();
    std::fs::write(folder.join("door.dca"), "process main() { internal_event_actions { arm } }\n").unwrap();
    std::fs::write(folder.join("leg.dca"), "process main() { internal_event_actions { leg } }\n").unwrap();
    let dca = PathBuf::from(env!("CARGO_BIN_EXE_dca"));
    let bin = dca.parent().map(Path::as_os_str).unwrap_or_default().to_string_lossy().into_owned();
    let shown = "lua vim.wait(30000, function() return #vim.diagnostic.get(0) > 0 end, 50); \
                 for _, found in ipairs(vim.diagnostic.get(0)) do io.stdout:write(found.message, '\\n') end";
    let mut editor = Command::new("timeout");
    editor.args(["90", "nvim", "--headless", "-u", "init.lua", "door.dca", "-c", shown]);
    // A second file goes to the same server.
    editor.args([
        "-c",
        "edit leg.dca",
        "-c",
        shown,
        "-c",
        "lua io.stdout:write(#vim.lsp.get_active_clients(), ' client')",
    ]);
    editor.args(["-c", "qa!"]).current_dir(&folder);
    editor.env("PATH", format!("{bin}:{}", std::env::var("PATH").unwrap_or_default()));
    for place in ["HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_STATE_HOME", "XDG_CACHE_HOME"] {
        editor.env(place, &folder);
    }
    let told = editor.output().unwrap();
    let text = format!("{}{}", String::from_utf8_lossy(&told.stdout), String::from_utf8_lossy(&told.stderr));
    assert!(text.contains("unknown process `arm`") && text.contains("unknown process `leg`"), "{text}");
    assert!(text.contains("1 client"), "{text}");
    std::fs::remove_dir_all(folder).unwrap();
}

/// The steps for VS Code name existing files.
#[test]
fn the_extension_is_what_the_page_installs() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../editors/vscode");
    let text = std::fs::read_to_string(folder.join("package.json")).unwrap();
    let package: serde_json::Value = serde_json::from_str(&text).unwrap();
    let file = format!("{}-{}.vsix", package["name"].as_str().unwrap(), package["version"].as_str().unwrap());
    assert!(block("## VS Code", "").contains(&format!("code --install-extension {file}")), "{file}");
    assert!(folder.join(package["main"].as_str().unwrap()).is_file());
}
