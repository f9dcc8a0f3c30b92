// deltarayd: the server.

#include <fcntl.h>
#include <malloc.h>
#include <signal.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <iostream>
#include <string>
#include <utility>
#include <vector>

#include "CLI/CLI.hpp"
#include "absl/strings/str_join.h"
#include "server/service/exit_deadline.h"
#include "server/service/listen_address.h"
#include "server/service/log.h"
#include "server/service/port_file.h"
#include "server/service/security_options.h"
#include "server/service/server.h"
#include "spdlog/sinks/stdout_color_sinks.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

constexpr int kFailure = 1;
constexpr int kUsage = 2;
constexpr int kHung = 3;
// What the end may take after the drain, until it counts as hung.
constexpr std::chrono::seconds kEndTime{10};

constexpr char kFooter[] =
    R"(Every flag can be given by the environment too: --data-dir as DELTARAY_DATA_DIR. The flag comes first.
Sizes take suffixes: 64MB, 4GB (powers of 1024).

Examples:
  deltarayd                                        serve this machine from ./deltaray-data at port 7878
  deltarayd --data-dir /var/lib/deltaray --listen 127.0.0.1:0 --port-file port
  deltarayd --listen 0.0.0.0:7878 --tls-cert server.pem --tls-key server.key --token-file tokens
  DELTARAY_THREADS=8 deltarayd --insecure-listen --listen 0.0.0.0:7878

Exit codes: 0 after one of the signals below; 1 where the server could not start; 2 for a wrong flag; 3 where something hung
until 10 s after the drain.
The first SIGTERM, SIGINT or SIGHUP lets batches under way finish, the second one ends the server at once.)";

struct Flags {
  ServerOptions server;
  std::string port_file;
  std::string log_level = "info";
  std::string log_format = "text";
  bool insecure_listen = false;
  bool insecure_metrics_listen = false;
  double drain_seconds = 10;
  double idle_seconds = 300;
  double watchdog_seconds = 5;
};

// Adds a flag that has an environment variable, and shows its default.
template <typename Value>
CLI::Option* AddFlag(CLI::App& app, const char* group, const std::string& name, Value& value, const char* help) {
  std::string variable = "DELTARAY_" + name;
  for (char& c : variable) c = c == '-' ? '_' : static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  return app.add_option("--" + name, value, help)->envname(variable)->group(group)->capture_default_str();
}

// CLI::Range lets it pass.
std::string NotNan(const std::string& number) {
  return std::isnan(std::strtod(number.c_str(), nullptr)) ? number + " is not a number" : "";
}

void AddFlags(CLI::App& app, Flags& flags) {
  ServerOptions& server = flags.server;
  const auto size = CLI::AsSizeValue(false);
  const CLI::Range threads(0, 4096);

  AddFlag(app, "Network", "listen", server.listen, "Address: host:port, or unix:path. Port 0 picks a free one")
      ->check([](const std::string& address) { return std::string(ValidateListenAddress(address).message()); });
  app.add_flag("--insecure-listen", flags.insecure_listen,
               "Listen at an address that other machines can reach, without encryption")
      ->envname("DELTARAY_INSECURE_LISTEN")
      ->group("Security");
  AddFlag(app, "Security", "tls-cert", server.security.tls_cert,
          "Certificate in PEM, then those that lead to its authority: encrypts all connections");
  AddFlag(app, "Security", "tls-key", server.security.tls_key, "Private key of that certificate in PEM");
  AddFlag(app, "Security", "tls-client-ca", server.security.tls_client_ca,
          "Authorities in PEM: lets in only clients that have a certificate of one of them");
  AddFlag(app, "Security", "token-file", server.security.token_file,
          "Lets in only calls with a token of this file; a line: read or write, and the token's SHA-256");
  AddFlag(app, "Network", "port-file", flags.port_file, "File to write the port to once the server listens");
  AddFlag(app, "Network", "drain-timeout", flags.drain_seconds,
          "Seconds that calls under way get to finish after SIGTERM")
      ->check(CLI::Range(0.0, 86400.0))
      ->check(NotNan);

  AddFlag(app, "Metrics", "metrics-listen", server.metrics_listen,
          "Address at which Prometheus fetches /metrics: host:port. Empty: nowhere")
      ->check([](const std::string& address) { return std::string(ValidateMetricsAddress(address).message()); });
  app.add_flag("--insecure-metrics-listen", flags.insecure_metrics_listen,
               "Show metrics at an address that other machines can reach, to whoever asks")
      ->envname("DELTARAY_INSECURE_METRICS_LISTEN")
      ->group("Metrics");

  app.add_flag("--channelz", server.channelz,
               "Tell of connections and calls by gRPC's channelz, to whoever asks, without a token")
      ->envname("DELTARAY_CHANNELZ")
      ->group("Metrics");

  AddFlag(app, "Network", "watchdog-interval", flags.watchdog_seconds,
          "Seconds between two looks of the server at whether it accepts connections and answers")
      ->check(CLI::Range(0.1, 3600.0))
      ->check(NotNan);

  AddFlag(app, "Storage", "data-dir", server.store.data_directory,
          "Directory that meshes are kept in; made if missing");

  AddFlag(app, "Threads", "threads", server.threads, "Threads that trace rays. 0: all cores")->check(threads);
  AddFlag(app, "Threads", "build-threads", server.store.build_threads, "Threads of one build. 0: all cores")
      ->check(threads);
  AddFlag(app, "Threads", "concurrent-builds", server.store.concurrent_builds, "Meshes built at the same time")
      ->check(CLI::Range(1, 1024));
  AddFlag(app, "Threads", "max-queued-builds", server.store.max_queued_builds, "Builds that wait for their turn")
      ->check(CLI::Range(1, 1 << 20));

  AddFlag(app, "Limits", "max-batch-rays", server.batch.max_rays, "Rays of one batch")->check(CLI::Range(1, 1 << 30));
  AddFlag(app, "Limits", "max-message-bytes", server.batch.max_message_bytes, "Bytes of one message, either way")
      ->transform(size)
      ->check(CLI::Range(4 << 20, 1 << 30));
  AddFlag(app, "Limits", "network-bytes", server.network_bytes,
          "Bytes of messages on their way in, over all connections; four messages where that is more")
      ->transform(size)
      ->check(CLI::Range(double{1 << 20}, 1e15));
  AddFlag(app, "Limits", "max-upload-bytes", server.store.max_upload_bytes, "Bytes of one uploaded file")
      ->transform(size)
      ->check(CLI::Range(1.0, 1e15));
  AddFlag(app, "Limits", "batch-bytes", server.batch_bytes,
          "Bytes of batches being answered and of replies not taken yet, over all clients; four messages where that "
          "is more")
      ->transform(size)
      ->check(CLI::Range(double{1 << 20}, 1e15));
  const CLI::Range count(1, 1 << 20);
  AddFlag(app, "Clients", "max-connections", server.max_connections,
          "Connections at once; fewer where the limit on open files is low")
      ->check(count);
  AddFlag(app, "Clients", "max-connection-calls", server.max_connection_calls, "Calls at once on one connection")
      ->check(count);
  AddFlag(app, "Clients", "max-calls", server.calls.calls, "Calls at once, of all kinds")->check(count);
  AddFlag(app, "Clients", "max-streams", server.calls.streams, "Streams of rays at once")->check(count);
  AddFlag(app, "Clients", "max-uploads", server.calls.uploads, "Uploads at once")->check(count);
  AddFlag(app, "Clients", "max-metadata-bytes", server.max_metadata_bytes, "Bytes of the metadata of one call")
      ->transform(size)
      ->check(CLI::Range(1 << 10, 1 << 20));
  AddFlag(app, "Clients", "idle-timeout", flags.idle_seconds,
          "Seconds that a stream, an upload, or a connection without calls may do nothing")
      ->check(CLI::Range(1.0, 86400.0))
      ->check(NotNan);

  AddFlag(app, "Log", "log-level", flags.log_level, "What to log on stderr")
      ->check(CLI::IsMember({"trace", "debug", "info", "warning", "error", "off"}));
  AddFlag(app, "Log", "log-format", flags.log_format, "Lines for people, or an object of JSON a line")
      ->check(CLI::IsMember({"text", "json"}));
}

// Limits on what one file holds.
void AddMeshLimits(CLI::App& app, MeshLimits& limits) {
  const auto size = CLI::AsSizeValue(false);
  const CLI::Range count(1.0, 2147483647.0);
  AddFlag(app, "Limits", "max-triangles", limits.max_triangles, "Triangles of one mesh")->check(count);
  AddFlag(app, "Limits", "max-vertices", limits.max_vertices, "Vertices of one mesh")->check(count);
  AddFlag(app, "Limits", "max-face-corners", limits.max_face_corners, "Corners of one polygon")
      ->check(CLI::Range(3, 1 << 20));
  AddFlag(app, "Limits", "max-line-bytes", limits.max_line_bytes, "Bytes of a line of a text format")
      ->transform(size)
      ->check(CLI::Range(1 << 10, 1 << 26));
  AddFlag(app, "Limits", "max-groups", limits.max_groups, "Groups of one mesh")->check(CLI::Range(1, 1 << 20));
  AddFlag(app, "Limits", "max-group-name-bytes", limits.max_group_name_bytes, "Bytes of the name of one group")
      ->transform(size)
      ->check(CLI::Range(1, 1 << 16));
  AddFlag(app, "Limits", "max-group-bytes", limits.max_group_bytes,
          "Bytes of the names of all groups of one mesh; at most a quarter of a message")
      ->transform(size)
      ->check(CLI::Range(1, 1 << 28));
}

// Limits of the store as a whole.
void AddStoreLimits(CLI::App& app, MeshStore::Options& store) {
  const auto size = CLI::AsSizeValue(false);
  AddFlag(app, "Limits", "tree-bytes", store.tree_bytes,
          "Bytes of memory of meshes and trees, those being built or uploaded included. Trees that were not used for "
          "longest make room, and are built again when asked for")
      ->transform(size)
      ->check(CLI::Range(double{1 << 20}, 1e15));
  AddFlag(app, "Limits", "max-stored-bytes", store.max_stored_bytes, "Bytes of all meshes and uploads on disk")
      ->transform(size)
      ->check(CLI::Range(1.0, 1e18));
  AddFlag(app, "Limits", "max-meshes", store.max_meshes, "Meshes")->check(CLI::Range(1.0, 1e9));
  AddFlag(app, "Limits", "max-names", store.max_names, "Names of all meshes")->check(CLI::Range(1.0, 1e9));
  AddFlag(app, "Limits", "max-names-per-mesh", store.max_names_per_mesh, "Names of one mesh")
      ->check(CLI::Range(1.0, 1e6));
}

// One file descriptor a connection: take as many as the system lets us.
void RaiseFileLimit() {
  rlimit limit;
  if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
  limit.rlim_cur = limit.rlim_max;
  if (setrlimit(RLIMIT_NOFILE, &limit) != 0) spdlog::warn("cannot raise the limit on open files");
}

// What is freed stays with malloc, for the messages of batches that come next: they would fault in their pages anew,
// which takes half of the throughput where page faults are expensive. What meshes and trees took, TreeBudget has given
// back.
void KeepFreedMessages() {
  mallopt(M_MMAP_THRESHOLD, 32 << 20);
  mallopt(M_TRIM_THRESHOLD, 64 << 20);
}

// Tells the version and every flag, given or not, as it is in force. None of them is a secret: those name files.
void LogConfiguration(const CLI::App& app, const ServerOptions& server) {
  std::vector<std::pair<std::string, std::string>> values{{"version", DELTARAY_VERSION}};
  for (const CLI::Option* option : app.get_options()) {
    if (option->get_envname().empty()) continue;  // --help, --version
    const std::string given = absl::StrJoin(option->results(), ",");
    const std::string unset = option->get_items_expected_max() == 0 ? "false" : option->get_default_str();
    const std::string& name = option->get_lnames().at(0);
    values.emplace_back(name, name == "network-bytes" ? absl::StrCat(server.network_bytes_in_force())
                              : name == "batch-bytes" ? absl::StrCat(server.batch_bytes_in_force())
                              : option->count() == 0  ? unset
                                                      : given);
  }
  LogFields fields;
  for (const auto& [name, value] : values) fields.emplace_back(name, value);
  LogEvent(spdlog::level::info, "deltarayd starts", fields);
  if (server.network_bytes_in_force() != server.network_bytes || server.batch_bytes_in_force() != server.batch_bytes) {
    spdlog::warn("--network-bytes and --batch-bytes are four times --max-message-bytes, {}, at least",
                 4 * server.batch.max_message_bytes);
  }
}

// Files opened later must not take the place of a standard stream that the server was started without.
void OpenStandardStreams() {
  int file;
  do file = open("/dev/null", O_RDWR | O_CLOEXEC);
  while (file >= 0 && file <= STDERR_FILENO);
  if (file >= 0) close(file);
}

// An empty value, where a variable was meant to hold the path, would leave the server open or without its meshes.
absl::Status CheckPaths(const CLI::App& app) {
  for (const char* name : {"--data-dir", "--tls-cert", "--tls-key", "--tls-client-ca", "--token-file"}) {
    const CLI::Option* const option = app.get_option(name);
    const char* const variable = std::getenv(option->get_envname().c_str());
    const bool empty_flag = option->count() > 0 && option->as<std::string>().empty();
    const bool empty_variable = option->count() == 0 && variable != nullptr && *variable == '\0';
    if (empty_flag || empty_variable) return absl::InvalidArgumentError(absl::StrCat(name, ": is given, but empty"));
  }
  return absl::OkStatus();
}

int Run(const Flags& flags) {
  // Before any thread is started, so that all of them inherit it and only sigwait below gets these signals.
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGHUP);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  // Both are told by errno too, to the one call that they concern; the signals would end the server.
  signal(SIGPIPE, SIG_IGN);
  signal(SIGXFSZ, SIG_IGN);
  RaiseFileLimit();
  KeepFreedMessages();

  ExitDeadline deadline(kHung);
  const ServerOptions& options = flags.server;
  absl::StatusOr<std::unique_ptr<Server>> server = Server::Start(options);
  if (!server.ok()) {
    spdlog::critical("cannot start: {}", std::string(server.status().message()));
    return kFailure;
  }
  if (!flags.port_file.empty()) {
    if (absl::Status status = WritePortFile(flags.port_file, (*server)->port()); !status.ok()) {
      spdlog::critical("{}", std::string(status.message()));
      return kFailure;
    }
  }
  LogEvent(spdlog::level::info, "listens",
           {{"address", options.listen},
            {"port", int64_t{(*server)->port()}},
            {"metrics_port", int64_t{(*server)->metrics_port()}},
            {"tracing_threads", int64_t{(*server)->threads()}}});

  int received = 0;
  sigwait(&signals, &received);
  pthread_sigmask(SIG_UNBLOCK, &signals, nullptr);
  spdlog::info("{}: draining, for at most {} s", absl::StrCat("SIG", sigabbrev_np(received)), flags.drain_seconds);
  deadline.Begin(options.drain_timeout + kEndTime);
  if (!(*server)->Drain()) spdlog::warn("some calls were cut off");
  server->reset();
  spdlog::info("ended");
  return 0;
}

int Main(int argc, char** argv) {
  OpenStandardStreams();
  Flags flags;
  flags.server.store.data_directory = "deltaray-data";
  CLI::App app("deltarayd: answers ray queries on triangle meshes, over gRPC.", "deltarayd");
  app.footer(kFooter);
  app.set_version_flag("--version", std::string("deltarayd ") + DELTARAY_VERSION);
  AddFlags(app, flags);
  AddMeshLimits(app, flags.server.store.mesh_limits);
  AddStoreLimits(app, flags.server.store);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    if (app.exit(e) != 0) return kUsage;
    if (std::cout.flush()) return 0;
    std::fprintf(stderr, "deltarayd: cannot write standard output: %s\n", std::strerror(errno));
    return kFailure;
  }
  const ServerOptions& server = flags.server;
  absl::Status status = CheckPaths(app);
  if (status.ok()) status = ValidateSecurity(server.security, server.listen, flags.insecure_listen);
  if (!status.ok()) {
    std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
    return kUsage;
  }
  const std::string& metrics_listen = flags.server.metrics_listen;
  if (!flags.insecure_metrics_listen && !metrics_listen.empty() && !IsLoopback(metrics_listen)) {
    std::fprintf(stderr,
                 "--metrics-listen: other machines can reach %s, and metrics are shown to whoever asks; "
                 "say --insecure-metrics-listen if that is meant\n",
                 metrics_listen.c_str());
    return kUsage;
  }
  flags.server.drain_timeout = std::chrono::milliseconds(static_cast<int64_t>(flags.drain_seconds * 1000));
  flags.server.watchdog_interval = std::chrono::milliseconds(static_cast<int64_t>(flags.watchdog_seconds * 1000));
  flags.server.idle_timeout = std::chrono::milliseconds(static_cast<int64_t>(flags.idle_seconds * 1000));
  spdlog::set_default_logger(spdlog::stderr_color_mt("deltarayd"));
  spdlog::set_formatter(MakeLogFormatter(flags.log_format == "json" ? LogFormat::kJson : LogFormat::kText));
  spdlog::set_level(spdlog::level::from_str(flags.log_level));
  TakeLibraryLogs();
  LogConfiguration(app, flags.server);
  return Run(flags);
}

}  // namespace
}  // namespace deltaray

int main(int argc, char** argv) {
  try {
    return deltaray::Main(argc, argv);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "deltarayd: %s\n", e.what());
    return 1;
  }
}
