// deltarayd: the server.

#include <malloc.h>
#include <signal.h>
#include <sys/resource.h>

#include <chrono>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <fstream>
#include <string>
#include <utility>

#include "CLI/CLI.hpp"
#include "absl/strings/str_cat.h"
#include "server/service/listen_address.h"
#include "server/service/server.h"
#include "spdlog/sinks/stdout_color_sinks.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

constexpr int kFailure = 1;
constexpr int kUsage = 2;

constexpr char kFooter[] =
    R"(Every flag can be given by the environment too: --data-dir as DELTARAY_DATA_DIR. The flag comes first.
Sizes take suffixes: 64MB, 4GB (powers of 1024).

Examples:
  deltarayd                                        serve this machine from ./deltaray-data at port 7878
  deltarayd --data-dir /var/lib/deltaray --listen 127.0.0.1:0 --port-file port
  DELTARAY_THREADS=8 deltarayd --insecure-listen --listen 0.0.0.0:7878

Exit codes: 0 after SIGTERM or SIGINT; 1 where the server could not start; 2 for a wrong flag.
The first SIGTERM or SIGINT lets batches under way finish, the second one ends the server at once.)";

struct Flags {
  ServerOptions server;
  std::string port_file;
  std::string log_level = "info";
  bool insecure_listen = false;
  double drain_seconds = 10;
};

// Adds a flag that has an environment variable, and shows its default.
template <typename Value>
CLI::Option* AddFlag(CLI::App& app, const char* group, const std::string& name, Value& value, const char* help) {
  std::string variable = "DELTARAY_" + name;
  for (char& c : variable) c = c == '-' ? '_' : static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  return app.add_option("--" + name, value, help)->envname(variable)->group(group)->capture_default_str();
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
      ->group("Network");
  AddFlag(app, "Network", "port-file", flags.port_file, "File to write the port to once the server listens");
  AddFlag(app, "Network", "drain-timeout", flags.drain_seconds,
          "Seconds that calls under way get to finish after SIGTERM")
      ->check(CLI::Range(0.0, 86400.0));

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
      ->check(CLI::Range(1 << 16, 1 << 30));
  AddFlag(app, "Limits", "network-bytes", server.network_bytes,
          "Bytes of messages on their way in, over all connections; at least four messages")
      ->transform(size)
      ->check(CLI::Range(double{1 << 20}, 1e15));
  AddFlag(app, "Limits", "max-upload-bytes", server.store.max_upload_bytes, "Bytes of one uploaded file")
      ->transform(size)
      ->check(CLI::Range(1.0, 1e15));
  AddFlag(app, "Limits", "max-triangles", server.store.mesh_limits.max_triangles, "Triangles of one mesh")
      ->check(CLI::Range(1.0, 2147483647.0));

  AddFlag(app, "Log", "log-level", flags.log_level, "What to log on stderr")
      ->check(CLI::IsMember({"trace", "debug", "info", "warning", "error", "off"}));
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
  if (setrlimit(RLIMIT_NOFILE, &limit) != 0) spdlog::warn("can not raise the limit on open files");
}

// By itself malloc takes ever larger arrays from its heaps, once some were freed, and keeps what they took: a mesh that
// made room for another would still take its memory.
void ReturnFreedArrays() { mallopt(M_MMAP_THRESHOLD, 1 << 20); }

// Written beside and renamed, so that whoever waits for the file never sees half a number.
bool WritePortFile(const std::string& path, int port) {
  const std::string temporary = path + ".tmp";
  std::ofstream file(temporary);
  file << port << '\n';
  file.close();
  std::error_code error;
  if (file) std::filesystem::rename(temporary, path, error);
  return file && !error;
}

int Run(const Flags& flags) {
  // Before any thread is started, so that all of them inherit it and only sigwait below gets these signals.
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  // Both are told by errno too, to the one call that they concern; the signals would end the server.
  signal(SIGPIPE, SIG_IGN);
  signal(SIGXFSZ, SIG_IGN);
  RaiseFileLimit();
  ReturnFreedArrays();

  const ServerOptions& options = flags.server;
  absl::StatusOr<std::unique_ptr<Server>> server = Server::Start(options);
  if (!server.ok()) {
    spdlog::critical("can not start: {}", std::string(server.status().message()));
    return kFailure;
  }
  if (!flags.port_file.empty() && !WritePortFile(flags.port_file, (*server)->port())) {
    spdlog::critical("can not write the port to {}", flags.port_file);
    return kFailure;
  }
  spdlog::info(
      "deltarayd {} listens at {}, port {}: data directory {}, {} tracing threads, {} threads a build, {} builds at "
      "once, at most {} rays a batch, {} bytes a message, {} bytes an upload, {} triangles a mesh, {} bytes of trees",
      DELTARAY_VERSION, options.listen, (*server)->port(), options.store.data_directory, (*server)->threads(),
      options.store.build_threads == 0 ? std::string("all") : absl::StrCat(options.store.build_threads),
      options.store.concurrent_builds, options.batch.max_rays, options.batch.max_message_bytes,
      options.store.max_upload_bytes, options.store.mesh_limits.max_triangles, options.store.tree_bytes);

  int received = 0;
  sigwait(&signals, &received);
  pthread_sigmask(SIG_UNBLOCK, &signals, nullptr);
  spdlog::info("{}: draining, for at most {} s", received == SIGTERM ? "SIGTERM" : "SIGINT", flags.drain_seconds);
  if (!(*server)->Drain()) spdlog::warn("some calls were cut off");
  server->reset();
  spdlog::info("ended");
  return 0;
}

int Main(int argc, char** argv) {
  Flags flags;
  flags.server.store.data_directory = "deltaray-data";
  CLI::App app("deltarayd: answers ray queries on triangle meshes, over gRPC.", "deltarayd");
  app.footer(kFooter);
  app.set_version_flag("--version", std::string("deltarayd ") + DELTARAY_VERSION);
  AddFlags(app, flags);
  AddStoreLimits(app, flags.server.store);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : kUsage;
  }
  if (!flags.insecure_listen && !IsLoopback(flags.server.listen)) {
    std::fprintf(stderr,
                 "--listen: other machines can reach %s, and the connection is not encrypted; "
                 "say --insecure-listen if that is meant\n",
                 flags.server.listen.c_str());
    return kUsage;
  }
  flags.server.drain_timeout = std::chrono::milliseconds(static_cast<int64_t>(flags.drain_seconds * 1000));
  spdlog::set_default_logger(spdlog::stderr_color_mt("deltarayd"));
  spdlog::set_level(spdlog::level::from_str(flags.log_level));
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
