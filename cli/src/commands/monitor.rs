//! `upswing monitor`: shows a running system live.

use super::{CommonArgs, print_json};
use serde::Serialize;
use std::io::IsTerminal;
use std::net::SocketAddr;
use upswing_config::Config;
use upswing_process::{Failure, colours, shutdown_flag};
use upswing_view::http::Listener;
use upswing_view::live::Live;
use upswing_view::monitor::{self, KeyState, Theme};
use upswing_view::page::LivePageSetup;
use upswing_view::web::{self, Token};

/// Shows a running system live: modes, rod, joints and their limits, cycle times, plans, faults.
///
/// In the terminal: e, u, d, h, r request enable, swing-up, swing-down, hold and reset after confirmation with y; s stops at
/// once; q quits the monitor. Angles on the screen are in deg. With --json: one snapshot, as one document in SI units. With --web:
/// a page for browsers at that address, read-only unless --allow-control is given.
///
/// Example: upswing monitor --web 127.0.0.1:8080
#[derive(Clone, Debug, clap::Args)]
pub struct MonitorArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Serve a page at this address instead; port 0: any free port [default: 127.0.0.1:8080]
    #[arg(long, value_name = "ADDRESS:PORT", num_args = 0..=1, default_missing_value = "127.0.0.1:8080")]
    pub web: Option<SocketAddr>,
    /// Allow requests from the page, with the token that is printed; only on this machine (127.0.0.1 or ::1)
    #[arg(long, requires = "web")]
    pub allow_control: bool,
}

#[derive(Serialize)]
struct MonitorStarted {
    url: String,
    token: Option<String>,
}

impl std::fmt::Display for MonitorStarted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.token {
            None => write!(f, "{} (read-only); Ctrl-C ends it", self.url),
            Some(token) => {
                write!(
                    f,
                    "{}#token={token}\nwho has this address can move the robot; Ctrl-C ends it",
                    self.url
                )
            }
        }
    }
}

/// Shows the running system until the user quits.
///
/// # Errors
/// [`Failure::BadInput`] if there is no terminal or an option is unusable, [`Failure::Failed`] if the domain cannot
/// be used.
pub fn run(args: &MonitorArgs) -> Result<(), Failure> {
    let config = args.common.process.load()?;
    if let Some(address) = args.web {
        return serve(args, &config, address);
    }
    if args.common.json {
        let mut live = Live::open(&args.common.join()?, &config).map_err(Failure::failed)?;
        live.settle().map_err(Failure::failed)?;
        return print_json(&live.view());
    }
    if !(std::io::stdout().is_terminal() && std::io::stdin().is_terminal()) {
        return Err(Failure::BadInput(
            "expected a terminal on stdin and stdout, got a pipe or a file; use --json for one snapshot, or --web".into(),
        ));
    }
    let stop = shutdown_flag()?;
    let mut live = Live::open(&args.common.join()?, &config).map_err(Failure::failed)?;
    let theme = Theme { colours: colours(&std::io::stdout()) };
    monitor::run(&mut live, KeyState::new(&config), theme, &stop).map_err(Failure::failed)
}

fn serve(args: &MonitorArgs, config: &Config, address: SocketAddr) -> Result<(), Failure> {
    if args.allow_control && !address.ip().is_loopback() {
        return Err(Failure::BadInput(format!(
            "--allow-control: expected an address of this machine alone (127.0.0.1 or [::1]), got {}; use ssh -L to \
             reach it from elsewhere",
            address.ip()
        )));
    }
    let stop = shutdown_flag()?;
    let token = args.allow_control.then(Token::new).transpose();
    let token = token.map_err(|e| Failure::failed(format!("no random numbers for the token: {e}")))?;
    let listener = Listener::bind(address).map_err(|e| Failure::BadInput(format!("--web: {e}")))?;
    let domain = &args.common.process.domain;
    let setup = LivePageSetup::new(domain, config, args.allow_control)
        .map_err(|e| Failure::BadInput(format!("robot.urdf: {e}")))?;
    let mut live = Live::open(&args.common.join()?, config).map_err(Failure::failed)?;
    let url = format!("http://{}/", listener.address);
    args.common.print(&MonitorStarted { url, token: token.as_ref().map(|t| t.text().to_owned()) })?;
    web::run(&mut live, listener, &setup, token, &stop).map_err(Failure::failed)
}
