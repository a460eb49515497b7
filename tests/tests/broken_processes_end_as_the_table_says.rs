//! Processes that stall, are killed, restart or send damaged plans have the results in docs/faults.md. Modes that continue
//! lose no cycle; Fault is left only by a reset or by the end of the process.

use std::sync::{LazyLock, mpsc};
use std::time::{Duration, Instant};
use upswing_config::Config;
use upswing_ipc::operator::{OperatorError, OperatorRequest};
use upswing_ipc::{Clock, Mode, PlanMessage, PlannerRequest};
use upswing_model::{ActuatedVector, State};
use upswing_planner::replan::Planner;
use upswing_rig::course::first_manoeuvre;
use upswing_rig::session::{Role, SessionError};
use upswing_tests::matrix::{PAGE, mode, table};
use upswing_tests::running::{LONG, wait_for};
use upswing_tests::{START, System};
use upswing_trajectory::Plan;
use upswingd::trip::TripCause;

const SECTION: &str = "Of processes";
const GOES_ON: &str = "goes on";
const STAYS: &str = "stays";
/// What becomes of a plant that is gone, and after how long at the least: a second, less what a look takes.
const LOST: &str = "Fault: StaleMeasurement";
const GONE: Duration = Duration::from_millis(900);
/// What has to go on goes on for so many cycles afterwards.
const AFTER: u64 = 1000;
/// What has to stay stays for so long.
const STAYING: Duration = Duration::from_millis(500);

fn check(column: Mode) {
    let (columns, rows) = table(PAGE, SECTION);
    let index = columns.iter().position(|name| mode(name) == column).expect("a column of the mode");
    // Before any system runs: making it takes longer than telemetry waits for its reader.
    LazyLock::force(&GOOD);
    // One that goes on serves again, unless its plan ends meanwhile.
    let mut last = None;
    for row in rows {
        let expected = &row.outcomes[index];
        let mut system = last.take().unwrap_or_else(|| {
            let mut system = System::start(Clock::Paced, START);
            system.bring_to(column);
            system
        });
        println!("{} in {column}", row.fault);
        let before = system.session.records.len() - 1;
        let dropped = system.session.dropped();
        let begin = Instant::now();
        act(&mut system, &row.fault);
        let took = begin.elapsed();
        if expected == GOES_ON {
            system.advance(AFTER);
            let seen = outcome(&mut system, column);
            assert_eq!(&seen, expected, "{} in {column}", row.fault);
            // One cycle per measurement; what a busy machine kept from this reader is told.
            let records = &system.session.records[before..];
            let [from, to] = [records.first(), records.last()].map(|record| *record.expect("a cycle"));
            let cycles = to.seq - from.seq;
            let missing = cycles + 1 - records.len() as u64;
            assert_eq!(
                (cycles, missing),
                (to.measurement_seq - from.measurement_seq, system.session.dropped() - dropped),
                "{} in {column}: cycles are lost",
                row.fault
            );
            last = Some(system)
                .filter(|_| matches!(column, Mode::Idle | Mode::Hold | Mode::Balance | Mode::Fault));
            continue;
        }
        let begin = Instant::now();
        loop {
            let seen = outcome(&mut system, column);
            if expected == STAYS {
                assert_eq!(seen, GOES_ON, "{} in {column}", row.fault);
                if begin.elapsed() > STAYING {
                    break;
                }
            } else if &seen == expected {
                break;
            } else if row.fault == "restart plant" && seen == LOST && took > GONE {
                // The machine took so long to start it that it was given up before.
                break;
            }
            assert!(begin.elapsed() < LONG, "{} in {column}: {seen}, expected {expected}", row.fault);
            system.pass(Duration::from_millis(20));
        }
        if expected.starts_with("Fault") {
            let refusal =
                system.session.request(OperatorRequest::Enable).expect_err("a fault is left by a reset only");
            assert!(matches!(refusal, SessionError::Operator(OperatorError::Daemon { .. })), "{refusal}");
        }
    }
}

/// Breaks what a row of the table names.
fn act(system: &mut System, fault: &str) {
    let words: Vec<_> = fault.split(' ').collect();
    match words[..] {
        ["stall", who, seconds, "s"] => {
            let time = Duration::from_secs_f64(seconds.parse().expect("a number"));
            system.stall(role(who), time);
        }
        ["kill", who] => {
            system.kill(role(who));
            if who == "planner" {
                system.advance(AFTER);
                system.restart(Role::Planner);
            }
        }
        ["restart", who] => system.restart(role(who)),
        ["kill", "planner", "while", "it", "plans"] => kill_planner_at_work(system),
        ["damage", "a", "plan", "in", "each", "field"] => damage_plans(system),
        ["replace", "the", "plan", "late", "or", "wrongly"] => replace_wrongly(system),
        ["load", "the", "CPUs", "for", seconds, "s"] => {
            load_cpus(system, Duration::from_secs_f64(seconds.parse().expect("a number")));
        }
        _ => panic!("no fault `{fault}`"),
    }
}

fn role(name: &str) -> Role {
    match name {
        "daemon" => Role::Daemon,
        "planner" => Role::Planner,
        "plant" => Role::Plant,
        _ => panic!("no process `{name}`"),
    }
}

fn outcome(system: &mut System, before: Mode) -> String {
    let braked = system.session.pid(Role::Plant).is_none() || system.brakes_closed();
    if system.session.pid(Role::Daemon).is_none() {
        return if braked { "brakes" } else { "open brakes without a daemon" }.into();
    }
    let status = system.status();
    let now = status.mode().expect("a known mode");
    match now {
        Mode::Idle | Mode::Fault if braked && now == before => GOES_ON.into(),
        Mode::Fault if braked => {
            let cause = TripCause::ALL.into_iter().find(|cause| cause.code() == status.fault);
            cause.map_or("Fault without a cause".into(), |cause| format!("Fault: {cause:?}"))
        }
        Mode::Fault => "Fault with open brakes".into(),
        Mode::Idle if braked => "brakes".into(),
        Mode::Idle => "Idle with open brakes".into(),
        // A plan, or a stop, may end meanwhile.
        Mode::Balance if before == Mode::Track => GOES_ON.into(),
        Mode::Hold if before == Mode::Stop => GOES_ON.into(),
        now if now == before => GOES_ON.into(),
        now => format!("ends in {now}"),
    }
}

/// The state in which the system starts.
fn start(config: &Config) -> State {
    let q_a = ActuatedVector::from_fn(config.model.sizes(), |i| START[i].to_radians());
    config.start_state(&q_a, config.plant.start.pendulum).expect("a start")
}

fn kill_planner_at_work(system: &mut System) {
    let node = system.session.node().clone();
    let (tell, told) = mpsc::channel();
    let asker = std::thread::spawn(move || {
        let config = Config::embedded().expect("settings");
        let request = PlannerRequest {
            publish: 1,
            // Many QPs, so that it is still at work when it dies.
            iterations: 50,
            ..PlannerRequest::from_state(first_manoeuvre(&config), config.model.order(), &start(&config))
        };
        let client = node.client::<PlannerRequest>().expect("a client");
        wait_for("the planner", || client.has_server().then_some(()));
        tell.send(()).expect("somebody listens");
        client.call(&request, Duration::from_secs(2)).is_ok()
    });
    wait_for("the planner", || {
        system.session.collect().expect("telemetry");
        told.try_recv().ok()
    });
    system.pass(Duration::from_millis(20));
    system.kill(Role::Planner);
    system.advance(AFTER);
    wait_for("the end of the request", || {
        system.session.collect().expect("telemetry");
        asker.is_finished().then_some(())
    });
    // Whether or not it was faster.
    let _ = asker.join().expect("the asking thread");
    system.restart(Role::Planner);
}

type Damage = fn(&mut Plan);

/// A plan without damage.
static GOOD: LazyLock<Plan> = LazyLock::new(|| {
    let config = Config::embedded().expect("settings");
    let planner = Planner::new(config.clone()).expect("the database fits");
    let iterations = config.planner.replan.iterations;
    planner.replan(&start(&config), iterations, None).expect("a plan").plan(&config)
});

/// In place of the planner, sends a plan once for each of its fields that is damaged; the daemon names the field.
fn damage_plans(system: &mut System) {
    let damages: [(&str, Damage); 9] = [
        ("fingerprint", |p| p.fingerprint ^= 1),
        ("id: expected", |p| p.id = 0),
        ("x at knot 50", |p| p.trajectory.x[50][3] = f64::NAN),
        ("u at knot 0", |p| p.trajectory.u[0][6] = f64::INFINITY),
        ("f at knot 100", |p| p.f[100][17] = f64::NAN),
        ("K at knot 7", |p| p.gains.knot_mut(7)[0] = f64::NAN),
        ("the final K", |p| p.gains.end_mut().fill(f64::NEG_INFINITY)),
        ("t_F", |p| p.trajectory.t_f *= -1.0),
        ("position of joint `joint_1`", |p| p.trajectory.x[20][0] = 10.0),
    ];
    let before = system.status().plan_id;
    system.kill(Role::Planner);
    let order = *system.config.model.order();
    let intervals = GOOD.trajectory.intervals();
    let publisher =
        system.session.node().plan_publisher(order.sizes(), intervals).expect("the planner's place");
    // What a planner with an error would send.
    let wrong = damages.into_iter().zip(1000..).map(|((word, damage), id)| {
        let mut plan = Plan { id, ..GOOD.clone() };
        damage(&mut plan);
        (word, PlanMessage::new(&plan, &order))
    });
    // What becomes of a plan on its way, or comes from a planner of another robot.
    let good = PlanMessage::new(&GOOD, &order);
    let mut changed = good.clone();
    changed.header.checksum ^= 1;
    let mut of_another_chain = good.clone();
    of_another_chain.header.joints += 1;
    of_another_chain.seal();
    let broken = [("checksum", changed), ("length", of_another_chain)];
    for (word, message) in wrong.chain(broken) {
        publisher.publish(&message).expect("published");
        wait_for(word, || {
            system.session.collect().expect("telemetry");
            let reason = system.status().reason.to_string();
            reason.contains("refused plan").then_some(())?;
            reason.contains(word).then_some(())
        });
        assert_eq!(system.status().plan_id, before, "{word}");
    }
    drop(publisher);
    system.restart(Role::Planner);
}

/// In place of the planner, sends plans that would replace the running one but are late, name an old plan, or are damaged; the daemon names the
/// reason.
fn replace_wrongly(system: &mut System) {
    const NOT_RUNNING: &str = "it replaces plan";
    let before = system.status();
    system.kill(Role::Planner);
    let order = *system.config.model.order();
    let publisher = system.session.node().plan_publisher(order.sizes(), GOOD.trajectory.intervals());
    let publisher = publisher.expect("the planner's place");
    let (running, due) = (Some(before.running_plan.max(1)), before.t_ns + 100_000_000);
    let of_old = Plan { id: 2001, activation_ns: Some(due), replaces: Some(3), ..GOOD.clone() };
    let late = Plan { id: 2002, activation_ns: Some(1), replaces: running, ..GOOD.clone() };
    let mut damaged = Plan { id: 2003, activation_ns: Some(due), replaces: running, ..GOOD.clone() };
    damaged.trajectory.x[50][3] = f64::NAN;
    // Without a running plan, or after its end, none can be replaced.
    let cases = [
        (of_old, [NOT_RUNNING, NOT_RUNNING]),
        (late, ["ms after the moment", NOT_RUNNING]),
        (damaged, ["x at knot 50", "x at knot 50"]),
    ];
    for (plan, words) in cases {
        publisher.publish(&PlanMessage::new(&plan, &order)).expect("published");
        let refused = format!("refused plan {}", plan.id);
        wait_for(words[0], || {
            system.session.collect().expect("telemetry");
            let reason = system.status().reason.to_string();
            (reason.contains(&refused) && words.iter().any(|word| reason.contains(word))).then_some(())
        });
        assert_eq!(system.status().plan_id, before.plan_id, "{}", words[0]);
    }
    drop(publisher);
    system.restart(Role::Planner);
}

/// More threads than CPUs that do nothing but count.
fn load_cpus(system: &mut System, time: Duration) {
    let end = Instant::now() + time;
    let hogs = std::thread::available_parallelism().map_or(4, |n| 2 * n.get());
    std::thread::scope(|threads| {
        for _ in 0..hogs {
            threads.spawn(|| {
                let mut count = 0_u64;
                while Instant::now() < end {
                    count = std::hint::black_box(count + 1);
                }
            });
        }
        system.pass(time);
    });
}

upswing_tests::in_each_mode!(check);
