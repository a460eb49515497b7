//! Draws a [`View`] in the terminal.

use super::{KeyState, rows};
use crate::live::{CycleView, JointView, LatencyPercentiles, Severity, View};
use ratatui::Frame;
use ratatui::layout::{Constraint, Flex, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::canvas::{Canvas, Circle, Line as Stroke};
use ratatui::widgets::{Block, Borders, Clear, Paragraph};
use std::collections::VecDeque;
use upswing_ipc::operator::OperatorRequest;

/// Style of the drawing: with colours, or with reversed and bold text instead.
#[derive(Clone, Copy, Debug)]
pub struct Theme {
    /// Whether to use colours.
    pub colours: bool,
}

/// Name and value of a column of the cycle times.
type Quantile = (&'static str, fn(&LatencyPercentiles) -> f64);

const QUANTILES: [Quantile; 5] = [
    ("p50", |t| t.p50),
    ("p99", |t| t.p99),
    ("p99.9", |t| t.p99_9),
    (LEAST, |t| t.p99_99),
    ("max", |t| t.max),
];
/// Column that is left out if not all columns have room.
const LEAST: &str = "p99.99";
/// Columns of the names of the cycle times, and of a number.
const NAME: usize = 8;
const NUMBER: usize = 7;

/// Share of a limit from which a bar has the colour of a warning.
const HIGH: f64 = 0.8;

impl Theme {
    fn ink(self, colour: Color) -> Style {
        if self.colours { Style::new().fg(colour) } else { Style::new() }
    }

    fn alarm(self) -> Style {
        self.ink(Color::Red).add_modifier(Modifier::BOLD | Modifier::REVERSED)
    }

    fn share(self, share: f64) -> Style {
        match share.abs() {
            s if s > 1.0 || !s.is_finite() => self.alarm(),
            s if s > HIGH => self.ink(Color::Yellow).add_modifier(Modifier::BOLD),
            _ => self.ink(Color::Cyan),
        }
    }

    fn mode(self, mode: &str) -> Style {
        match mode {
            "fault" => self.alarm(),
            "stop" => self.ink(Color::Magenta).add_modifier(Modifier::BOLD),
            "track" => self.ink(Color::Yellow).add_modifier(Modifier::BOLD),
            "balance" => self.ink(Color::Green).add_modifier(Modifier::BOLD),
            _ => self.ink(Color::Cyan).add_modifier(Modifier::BOLD),
        }
    }
}

/// Draws the view; parts that do not fit into a small terminal are cut off.
pub fn draw(frame: &mut Frame, view: &View, keys: &KeyState, theme: Theme) {
    let [head, upper, lower, events, foot] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(12),
        Constraint::Length(7),
        Constraint::Min(3),
        Constraint::Length(1),
    ])
    .areas(frame.area());
    let [joints, pendulum] = Layout::horizontal([Constraint::Min(44), Constraint::Length(34)]).areas(upper);
    let [times, plan] = Layout::horizontal([Constraint::Fill(1), Constraint::Fill(1)]).areas(lower);
    frame.render_widget(heading(view, theme), head);
    draw_joints(frame, joints, view.cycle.as_ref(), theme);
    draw_pendulum(frame, pendulum, view.cycle.as_ref(), theme);
    draw_times(frame, times, view, theme);
    draw_plan(frame, plan, view, theme);
    draw_events(frame, events, view, theme);
    frame.render_widget(footer(keys, theme), foot);
    if let Some(request) = keys.waiting() {
        confirm(frame, request, theme);
    } else if keys.help() {
        help(frame, keys, theme);
    }
}

fn heading(view: &View, theme: Theme) -> Line<'_> {
    let mode = view.mode.as_deref().unwrap_or("no daemon");
    let mut spans = vec![
        Span::styled(" upswing ", Style::new().add_modifier(Modifier::BOLD)),
        Span::raw(format!(" domain {}  ", view.domain)),
        Span::styled(format!(" {} ", mode.to_uppercase()), theme.mode(mode)),
        Span::raw("  "),
    ];
    for (name, here) in [("daemon", view.daemon), ("planner", view.planner), ("plant", view.plant)] {
        let (sign, style) =
            if here { ("●", theme.ink(Color::Green)) } else { ("○", theme.ink(Color::Red)) };
        spans.push(Span::styled(format!("{sign} "), style));
        spans.push(Span::raw(format!("{name}  ")));
    }
    if let Some(asking) = &view.asking {
        spans.push(Span::styled(format!("{asking} ..."), theme.ink(Color::Yellow)));
    }
    Line::from(spans)
}

/// Most characters of the name of a joint that are shown.
const JOINT: usize = 14;

fn draw_joints(frame: &mut Frame, area: Rect, cycle: Option<&CycleView>, theme: Theme) {
    let block = Block::bordered().title(" Joints: position, velocity, torque ");
    let inner = block.inner(area);
    frame.render_widget(block, area);
    let Some(cycle) = cycle else {
        return frame.render_widget(nothing("no cycles arrive: is a plant running?"), inner);
    };
    let name = cycle.joints.iter().map(|joint| joint.name.chars().count()).max().unwrap_or(0).min(JOINT);
    // The position with its unit takes 14 columns, the gaps and shares 15 more.
    let free = usize::from(inner.width).saturating_sub(name + 29);
    let (wide, narrow) = (free / 2, free / 4);
    let each = narrow + 5;
    let mut lines = vec![Line::styled(
        format!(" {:name$}    position  {:wide$} {:>each$} {:>each$}", "", "", "velocity", "torque"),
        theme.ink(Color::DarkGray),
    )];
    lines.extend(cycle.joints.iter().map(|joint| joint_line(joint, (name, wide, narrow), theme)));
    frame.render_widget(Paragraph::new(lines), inner);
}

/// Draws a joint; widths of the name, of the mark of the position and of the other bars.
fn joint_line(joint: &JointView, (name, wide, narrow): (usize, usize, usize), theme: Theme) -> Line<'static> {
    let (position, velocity) = (joint.position(), joint.velocity());
    let percent = |share: f64| format!("{:>4.0}%", 100.0 * share.abs());
    let mut spans = vec![
        Span::raw(format!(" {:name$.name$}", joint.name)),
        Span::raw(format!("{:>8.2} {:<3} ", joint.shown, joint.unit)),
        Span::styled(rows::mark(position, wide), theme.share(position)),
        Span::raw(percent(velocity)),
        Span::raw(" "),
        Span::styled(rows::bar(velocity, narrow), theme.share(velocity)),
    ];
    if let Some(torque) = joint.torque() {
        spans.push(Span::raw(percent(torque)));
        spans.push(Span::raw(" "));
        spans.push(Span::styled(rows::bar(torque, narrow), theme.share(torque)));
    }
    Line::from(spans)
}

/// The last link seen along the world's x and y axes; up is up.
fn draw_pendulum(frame: &mut Frame, area: Rect, cycle: Option<&CycleView>, theme: Theme) {
    let tilt = cycle.map_or_else(String::new, |c| format!(": {:.1} deg from upright ", c.tilt.to_degrees()));
    let block = Block::bordered().title(format!(" Tip{tilt}"));
    let inner = block.inner(area);
    frame.render_widget(block, area);
    let Some(cycle) = cycle else { return };
    // A character is about twice as high as wide; two dials of radius 1 stand side by side.
    let (width, height) = (f64::from(inner.width), 2.0 * f64::from(inner.height));
    let unit = (width / 4.8).min(height / 2.6);
    if !(unit > 0.0) || !cycle.rod.iter().all(|v| v.is_finite()) {
        return;
    }
    let [x, y, z] = cycle.rod;
    let colour = |colour: Color| if theme.colours { colour } else { Color::Reset };
    let canvas = Canvas::default()
        .x_bounds([-width / unit / 2.0, width / unit / 2.0])
        .y_bounds([-height / unit / 2.0, height / unit / 2.0])
        .paint(|context| {
            for (centre, across, name) in [(-1.2, y, "front"), (1.2, x, "side")] {
                context.draw(&Circle { x: centre, y: 0.0, radius: 1.0, color: colour(Color::DarkGray) });
                let (x2, y2) = (centre + 0.95 * across, 0.95 * z);
                context.draw(&Stroke { x1: centre, y1: 0.0, x2, y2, color: colour(Color::Red) });
                context.draw(&Circle { x: x2, y: y2, radius: 0.08, color: colour(Color::Red) });
                context.print(centre - 0.3, -height / unit / 2.0, name);
            }
        });
    frame.render_widget(canvas, inner);
}

fn draw_times(frame: &mut Frame, area: Rect, view: &View, theme: Theme) {
    let block = Block::bordered().title(" Cycle times, us ");
    let Some(status) = &view.status else {
        return frame.render_widget(nothing("the daemon does not answer").block(block), area);
    };
    let all = usize::from(block.inner(area).width) >= NAME + QUANTILES.len() * NUMBER;
    let quantiles = || QUANTILES.into_iter().filter(move |(name, _)| all || *name != LEAST);
    let heading: String = quantiles().map(|(name, _)| format!("{name:>NUMBER$}")).collect();
    let row = |name: &str, t: &LatencyPercentiles| {
        let numbers: String = quantiles().map(|(_, of)| format!("{:>NUMBER$.1}", of(t))).collect();
        Line::raw(if t.count > 0 {
            format!("{name:<NAME$}{numbers}")
        } else {
            format!("{name:<NAME$} not measured")
        })
    };
    let mut lines = vec![
        Line::styled(format!("{:NAME$}{heading}", ""), theme.ink(Color::DarkGray)),
        row("wake-up", &status.wake_us),
        row("compute", &status.compute_us),
    ];
    if status.overruns == 0 {
        lines.push(Line::raw(format!("{} cycles, none late, {} lost", status.cycles, view.lost)));
    } else {
        let late = theme.ink(Color::Yellow);
        let counts = format!("{} of {} late, {} lost", status.overruns, status.cycles, view.lost);
        // The text before the colon names the cycle and its phase. The rest is shown as an event.
        let last = status.last_overrun.as_deref().and_then(|text| text.split(':').next());
        let last = format!("last: {}", last.unwrap_or("no cause known"));
        lines.extend([Line::styled(counts, late), Line::styled(last, late)]);
    }
    frame.render_widget(Paragraph::new(lines).block(block), area);
}

fn draw_plan(frame: &mut Frame, area: Rect, view: &View, theme: Theme) {
    let plan = match &view.plan {
        None => "none seen yet".into(),
        Some(plan) => {
            let running = view.cycle.as_ref().filter(|c| c.plan.as_ref() == Some(&plan.id));
            let state = running.map_or_else(String::new, |c| format!(", at {:.2} s", c.t_plan));
            let end = if plan.stands { "up" } else { "down" };
            format!("{:.3} s, ends {end}{state}", plan.t_f)
        }
    };
    let fault = view.cycle.as_ref().and_then(|c| c.fault);
    let warnings = view.status.as_ref().map(|s| s.warnings.join(", ")).filter(|w| !w.is_empty());
    let remark = view.status.as_ref().map(|s| s.remark.clone()).filter(|r| !r.is_empty());
    let none = || "none".to_owned();
    let lines = vec![
        Line::raw(format!("{:<9}{plan}", "plan")),
        match fault {
            Some(fault) => Line::styled(format!("{:<9}{fault}", "fault"), theme.alarm()),
            None => Line::raw(format!("{:<9}none", "fault")),
        },
        Line::raw(format!("{:<9}{}", "warnings", warnings.unwrap_or_else(none))),
        Line::raw(format!("{:<9}{}", "remark", remark.unwrap_or_else(none))),
        Line::raw(format!("{:<9}{}", "next", view.next.as_deref().unwrap_or("start a daemon"))),
    ];
    frame.render_widget(Paragraph::new(lines).block(Block::bordered().title(" Plan and limits ")), area);
}

fn draw_events(frame: &mut Frame, area: Rect, view: &View, theme: Theme) {
    let block = Block::new().borders(Borders::TOP).title(" Events, s since the monitor began ");
    let inner = block.inner(area);
    frame.render_widget(block, area);
    let width = usize::from(inner.width).max(1);
    let mut lines = VecDeque::new();
    // The newest event is at the bottom; the oldest lines are cut if there is no room.
    for event in view.events.iter().rev() {
        let style = match event.kind {
            Severity::Note => Style::new(),
            Severity::Warning => theme.ink(Color::Yellow),
            Severity::Fault => theme.alarm(),
        };
        let text: Vec<char> = format!("{:>8.1}  {}", event.t, event.text).chars().collect();
        for part in text.chunks(width).rev() {
            if lines.len() == usize::from(inner.height) {
                break;
            }
            lines.push_front(Line::styled(part.iter().collect::<String>(), style));
        }
    }
    frame.render_widget(Paragraph::new(Vec::from(lines)), inner);
}

fn footer(keys: &KeyState, theme: Theme) -> Line<'_> {
    // The line takes 77 of 80 columns for the iiwa.
    let keys = keys
        .requests()
        .iter()
        .map(|(key, request)| (*key, request.name()))
        .chain([('q', "quit"), ('?', "help")]);
    let key = Style::new().add_modifier(Modifier::REVERSED);
    Line::from_iter(keys.flat_map(|(c, name)| {
        [Span::styled(format!(" {c} "), key), Span::styled(format!("{name} "), theme.ink(Color::Gray))]
    }))
}

fn help(frame: &mut Frame, keys: &KeyState, theme: Theme) {
    let lines: Vec<_> = keys
        .requests()
        .iter()
        .map(|(key, request)| format!(" {key}  {:<11}{}", request.name(), effect(*request)))
        .chain([
            " q  quit       The monitor ends, the system goes on.".into(),
            String::new(),
            " All but stop ask first: y is yes, any other key no.".into(),
            " Bars: shares of the 100 % limits.".into(),
            " Any key closes this help; s still stops.".into(),
        ])
        .map(Line::raw)
        .collect();
    popup(frame, 66, " Keys ", lines, false, theme);
}

/// Effect of a request on the robot.
fn effect(request: OperatorRequest) -> &'static str {
    match request {
        OperatorRequest::Enable => "The brakes open and the robot holds its pose.",
        OperatorRequest::Manoeuvre(_) => "The robot moves fast.",
        OperatorRequest::Hold => "The robot holds its pose; what stands falls.",
        OperatorRequest::Stop => "The robot decelerates.",
        OperatorRequest::Reset => "The fault is forgotten; brakes stay closed.",
    }
}

/// Draws a box in the middle of the screen.
fn popup(frame: &mut Frame, width: u16, title: &str, lines: Vec<Line<'_>>, centered: bool, theme: Theme) {
    let height = u16::try_from(lines.len() + 2).unwrap_or(u16::MAX);
    let [row] = Layout::vertical([Constraint::Length(height)]).flex(Flex::Center).areas(frame.area());
    let [area] = Layout::horizontal([Constraint::Length(width)]).flex(Flex::Center).areas(row);
    let block = Block::bordered().title(title).style(theme.ink(Color::Yellow));
    let text = Paragraph::new(lines).block(block);
    frame.render_widget(Clear, area);
    frame.render_widget(if centered { text.centered() } else { text }, area);
}

fn confirm(frame: &mut Frame, request: OperatorRequest, theme: Theme) {
    let lines = vec![
        Line::raw(effect(request)),
        Line::raw(""),
        Line::styled("y: yes   any other key: no", Style::new().add_modifier(Modifier::BOLD)),
    ];
    popup(frame, 56, &format!(" {}? ", request.name()), lines, true, theme);
}

fn nothing(text: &str) -> Paragraph<'_> {
    Paragraph::new(text).centered()
}
